/** Groups of places at which the search could not follow an airway; a common text of a group is shown once. */

import type { UncertainPlace } from "../wire/messages";

/** A group of places of the same kind. */
export interface UncertainGroup {
  /** Possible reasons for all places of the group; null where each place has its own text. */
  readonly why: string | null;
  readonly places: readonly { readonly place: UncertainPlace; readonly words: string }[];
}

/** Group places by kind, in the order of their first occurrence. The server supplies the texts. */
export function groupsOf(places: readonly UncertainPlace[]): UncertainGroup[] {
  const kinds = new Map<UncertainPlace["kind"], UncertainPlace[]>();
  for (const place of places) kinds.set(place.kind, [...(kinds.get(place.kind) ?? []), place]);
  return [...kinds.values()].map((members) => {
    const why = members.length > 1 ? (members[0]?.explanation ?? null) : null;
    return {
      why,
      places: members.map((place) => ({
        place,
        words:
          why === null && place.explanation !== null ? `${place.statement}: ${place.explanation}` : place.statement,
      })),
    };
  });
}
