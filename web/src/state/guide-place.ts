/** Place of the card of a hint or of a stop of the tour beside the element that the card explains. */

/** Box of an element in the window, CSS px. */
export interface Box {
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
}

/** Width and largest height of the card, its distance from the element, and its distance from the window's edge, px. */
const CARD = { width: 300, height: 180, gap: 12, edge: 8 } as const;

/** Return the place of the card: beside its element where the window has space, else inside the element's box. */
export function cardPlace(box: Box | null, width: number, height: number): { left: number; top: number } {
  const within = (left: number, top: number) => ({
    left: Math.round(Math.min(Math.max(left, CARD.edge), Math.max(width - CARD.width - CARD.edge, CARD.edge))),
    top: Math.round(Math.min(Math.max(top, CARD.edge), Math.max(height - CARD.height - CARD.edge, CARD.edge))),
  });
  if (box === null) return within((width - CARD.width) / 2, height - CARD.height - 100);
  const { left, top } = box;
  const right = left + box.width;
  const bottom = top + box.height;
  const centre = left + (box.width - CARD.width) / 2;
  if (right + CARD.gap + CARD.width <= width) return within(right + CARD.gap, top);
  if (bottom + CARD.gap + CARD.height <= height) return within(centre, bottom + CARD.gap);
  if (top - CARD.gap - CARD.height >= 0) return within(centre, top - CARD.gap - CARD.height);
  if (left - CARD.gap - CARD.width >= 0) return within(left - CARD.gap - CARD.width, top);
  return within(left + CARD.gap, bottom - CARD.gap - CARD.height);
}
