/** Choices for pictures that the user saves or copies: size and marks. */

import type { ViewName } from "../wire/messages";
import { VIEWS } from "../wire/views";

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
  const { scaled, named } = VIEWS[view];
  if (mark === "scaleBar") return scaled ? null : "A view in perspective has no single scale.";
  return named ? null : "This view shows no single branches.";
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
