/** Places that could not be followed, said once for all that have the same reason. */

import type { UncertainPlace } from "../wire/messages";

export interface UncertainGroup {
  /** Why, for all of them; null where each says it by itself. */
  readonly why: string | null;
  readonly places: readonly { readonly place: UncertainPlace; readonly words: string }[];
}

/** Grouped by what follows the first colon of their words, in the order in which the groups begin. */
export function groupsOf(places: readonly UncertainPlace[]): UncertainGroup[] {
  const groups = new Map<string, { place: UncertainPlace; words: string }[]>();
  for (const place of places) {
    const at = place.words.indexOf(": ");
    const why = at < 0 ? place.words : place.words.slice(at + 2);
    const words = at < 0 ? place.words : place.words.slice(0, at);
    groups.set(why, [...(groups.get(why) ?? []), { place, words }]);
  }
  return [...groups].map(([why, members]) =>
    members.length > 1
      ? { why, places: members }
      : { why: null, places: members.map(({ place }) => ({ place, words: place.words })) },
  );
}
