/**
 * Host element of one view's canvases. The {@link Viewport} does not use React; this component only attaches it and
 * reports its size.
 */

import { useEffect, useRef } from "react";
import type { Shape } from "../views/outline";
import { Viewport } from "../views/viewport";
import type { ViewName } from "../wire/messages";
import { useStation } from "./context";
import { gesturesOf } from "./gestures";

/**
 * Call a function when the number of device pixels per CSS pixel changes, as between two screens; return a function that
 * ends this. The size of an element may stay the same, so a `ResizeObserver` does not notice the change.
 */
function onPixelRatioChange(changed: () => void): () => void {
  let query = window.matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
  const react = () => {
    query.removeEventListener("change", react);
    query = window.matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
    query.addEventListener("change", react);
    changed();
  };
  query.addEventListener("change", react);
  return () => query.removeEventListener("change", react);
}

interface PictureViewProps {
  view: ViewName;
  shape: Shape;
  name: string;
  onDoubleClick: () => void;
}

/** Render the host element of a view's canvases. */
export function PictureView({ view, shape, name, onDoubleClick }: PictureViewProps) {
  const station = useStation();
  const host = useRef<HTMLDivElement>(null);
  const viewport = useRef<Viewport | null>(null);
  const double = useRef(onDoubleClick);
  double.current = onDoubleClick;
  const first = useRef({ view, shape });

  useEffect(() => {
    const element = host.current;
    if (element === null) return;
    const made = new Viewport(element, first.current.view, first.current.shape);
    viewport.current = made;
    const measure = () => {
      made.resize(element.clientWidth, element.clientHeight, window.devicePixelRatio || 1);
      station.wall.touchLayout();
    };
    measure();
    const observer = new ResizeObserver(measure);
    observer.observe(element);
    const stopWatching = onPixelRatioChange(measure);
    const remove = station.wall.add(made);
    const stopGestures = gesturesOf(station, made, () => double.current());
    return () => {
      observer.disconnect();
      stopWatching();
      stopGestures();
      remove();
      viewport.current = null;
    };
  }, [station]);

  useEffect(() => {
    first.current = { view, shape };
    const made = viewport.current;
    if (made !== null) station.wall.show(made, view, shape);
  }, [station, view, shape]);

  // biome-ignore lint/a11y/noNoninteractiveTabindex: a picture handles keys (crosshair, zoom, full view)
  return <div ref={host} className="picture-host" tabIndex={0} role="img" aria-label={name} />;
}
