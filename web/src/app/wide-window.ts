/** Hook that returns whether the window is wide: tri-plane beside the tree. */

import { useSyncExternalStore } from "react";

/** Minimum width of a wide window, CSS px; the style sheets use the same width. */
const WIDE_PX = 1600;

const query = window.matchMedia(`(min-width: ${WIDE_PX}px)`);

function subscribe(changed: () => void): () => void {
  query.addEventListener("change", changed);
  return () => query.removeEventListener("change", changed);
}

/** Return whether the window is wide; render the component again when the answer changes. */
export const useWideWindow = (): boolean => useSyncExternalStore(subscribe, () => query.matches);
