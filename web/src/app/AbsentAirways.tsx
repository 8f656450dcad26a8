/**
 * Panel of the lobes and segments without a detected bronchus, each with its reason and a button that shows where the
 * search ended.
 */

import { Button } from "react-aria-components";
import { plural, sentence } from "../state/format";
import { asVec3 } from "../state/vec";
import type { AbsentAirway } from "../wire/messages";
import { useApp, useStation } from "./context";
import { showPlace } from "./gestures-flat";

const NONE: readonly AbsentAirway[] = [];

/** Render the list of the lobes and segments without a detected bronchus; nothing if there are none. */
export function AbsentAirways() {
  const station = useStation();
  const absent = useApp((state) => state.tree?.absent ?? NONE);
  if (absent.length === 0) return null;
  return (
    <details className="uncertain" name="doubts" data-testid="absent">
      <summary>{plural(absent.length, "bronchus", "bronchi")} not found</summary>
      <div className="places">
        <ul>
          {togetherLost(absent).map(({ names, reason, lps }) => {
            const words = (
              <>
                <span className="quiet">{`${names.join(", ")}: `}</span>
                {sentence(reason)}
              </>
            );
            return (
              <li key={names[0]}>
                {lps === null ? (
                  <p className="plain-text">{words}</p>
                ) : (
                  <Button className="plain-text" onPress={() => showPlace(station, asVec3(lps), null)}>
                    {words}
                  </Button>
                )}
              </li>
            );
          })}
        </ul>
      </div>
    </details>
  );
}

/** Group missing airways that have the same reason and place, so that the list shows the reason once. */
function togetherLost(absent: readonly AbsentAirway[]) {
  const groups = new Map<string, { names: string[]; reason: string; lps: AbsentAirway["lps"] }>();
  for (const { name, reason, lps } of absent) {
    const key = `${reason} ${lps?.join(" ")}`;
    const group = groups.get(key) ?? { names: [], reason, lps };
    group.names.push(name);
    groups.set(key, group);
  }
  return [...groups.values()];
}
