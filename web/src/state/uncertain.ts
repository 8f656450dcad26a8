/** Places that could not be followed in words: what all of a kind have in common is said once. */

import type { Uncertainty } from "../wire/messages";
import { fixed, mm } from "./format";

export interface UncertainGroup {
  /** Why, for all of them; null where each says it by itself. */
  readonly why: string | null;
  readonly places: readonly { readonly place: Uncertainty; readonly words: string }[];
}

/** What is found at a place, and why where all of its kind have that in common. */
function wordsOf(place: Uncertainty): { what: string; why: string | null } {
  const width = mm(place.width_mm);
  switch (place.kind) {
    case "volume":
      return { what: `the scan ends here, but the airway (${width} wide) continues`, why: null };
    case "leak":
      return {
        what: `lost where the lumen is ${width} wide`,
        why: "its wall is too thin here, and the search would have leaked into the lung",
      };
    case "blocked":
      return {
        what: `the lumen ends where it is ${width} wide`,
        why: "possibly mucus, a collapsed or narrowed airway, or a wall that the CT does not show",
      };
    case "filled":
      return {
        what: filledWords(place),
        why: "possibly secretions or a mucus plug; a CT cannot distinguish these from a tumour or a collapsed airway",
      };
    case "faint":
      return {
        what: `its wall is barely visible (confidence ${fixed(place.confidence ?? 0, 2)})`,
        why: "it may not be an airway",
      };
    case "fine":
      return {
        what:
          `this CT (${mm(place.voxel_mm ?? 0, 2)} voxels) does not reliably show airways narrower than ${width}, the ` +
          `median width at ${ends(place.num_ends ?? 0)}: there are smaller airways that are not shown`,
        why: null,
      };
  }
}

/** How long, how much air, and from wall to wall. */
function filledWords(place: Uncertainty): string {
  const air = place.width_mm === 0 ? "no air is visible" : `the air is ${mm(place.width_mm)} wide`;
  const calibre = place.calibre_mm;
  const bronchus =
    calibre === null
      ? "; its calibre from wall to wall cannot be measured here"
      : ` in a bronchus ${fixed(calibre, 1)} \u00b1 ${mm(place.calibre_error_mm ?? 0)} wide from wall to wall`;
  const beyond = place.beyond_lps === null ? "" : "; there is an airway beyond it, which a bridge can reach";
  return `narrowed or filled here over ${mm(place.length_mm ?? 0, 0)}: ${air}${bronchus}${beyond}`;
}

const ends = (count: number): string => (count === 1 ? "the thinnest branch end" : `the ${count} thinnest branch ends`);

/** Grouped by kind, in the order in which the kinds begin. */
export function groupsOf(places: readonly Uncertainty[]): UncertainGroup[] {
  const kinds = new Map<Uncertainty["kind"], Uncertainty[]>();
  for (const place of places) kinds.set(place.kind, [...(kinds.get(place.kind) ?? []), place]);
  return [...kinds.values()].map((members) => {
    const said = members.map((place) => ({ place, ...wordsOf(place) }));
    const why = members.length > 1 ? (said[0]?.why ?? null) : null;
    return {
      why,
      places: said.map(({ place, what, why: own }) => ({
        place,
        words: why === null && own !== null ? `${what}: ${own}` : what,
      })),
    };
  });
}
