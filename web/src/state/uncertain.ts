/**
 * Grouping of the places at which the search could not follow an airway, so that a common explanation is shown once.
 */

import type { UncertainPlace } from "../wire/messages";

/** Group of uncertain places of the same kind, which the list shows together. */
export interface UncertainGroup {
  /** Explanation that all places of the group have in common; null if each place has its own text. */
  readonly why: string | null;
  readonly places: readonly { readonly place: UncertainPlace; readonly words: string }[];
}

/**
 * Group places by their kind, in the order of their first occurrence. The explanation of a group with several places is
 * that of its first place. The server supplies the texts.
 */
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
