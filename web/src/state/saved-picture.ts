/** Choices for pictures that the user saves or copies: size and marks. */

import type { ViewName } from "../wire/messages";
import { type CellName, LEAD_VIEW, VIEWS } from "../wire/views";
import type { ShownViews } from "./view-table";

/** Size and marks of a saved picture. */
export interface PictureChoice {
  /** Factor of the size on the screen. */
  readonly scale: 1 | 2;
  readonly letters: boolean;
  readonly scaleBar: boolean;
  readonly names: boolean;
}

/** Choices before the user has changed them. */
export const FIRST_PICTURE: PictureChoice = { scale: 1, letters: true, scaleBar: true, names: true };

/** Pixels of a view on the screen, and the width of the picture that the server renders for it. */
export interface ScreenSize {
  readonly width: number;
  readonly height: number;
  readonly fullWidth: number;
}

/** Return the reason why a view's picture cannot show a mark, as text for the user; null if the picture can. */
export function markProblem(view: ViewName, mark: "scaleBar" | "names"): string | null {
  const { scaled, named, pick } = VIEWS[view];
  if (mark === "scaleBar") return scaled ? null : "A view in perspective has no single scale.";
  if (named) return null;
  // The tri-plane shows planes of the scan; the other views without names are X-rays.
  return pick === "planes" ? "This view shows no single branches." : "An X-ray superimposes the branches.";
}

/** Return the name of a view in a sentence about its picture: "axial slice", "X-ray (AP)". */
export function pictureName(view: ViewName): string {
  const { title, short, words } = VIEWS[view];
  return short === "" ? words : `${title} (${short})`;
}

/** Return the view that the key saves: the focused view, else the view in full view, else the airway view. */
export function viewToSave(
  focused: ViewName | null,
  { full, shown }: { readonly full: CellName | null; readonly shown: ShownViews },
): ViewName {
  return focused ?? (full === null ? LEAD_VIEW : shown[full]);
}

/** Return the query of the request for a picture. */
export function pictureQuery(window: number, size: ScreenSize, choice: PictureChoice): string {
  const onOff = (on: boolean): string => (on ? "on" : "off");
  return new URLSearchParams({
    window: String(window),
    width: String(size.width),
    height: String(size.height),
    full_width: String(size.fullWidth),
    scale: String(choice.scale),
    letters: onOff(choice.letters),
    scale_bar: onOff(choice.scaleBar),
    names: onOff(choice.names),
  }).toString();
}
