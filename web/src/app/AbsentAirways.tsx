/** Lobes and segments of which no bronchus was found: each with its reason, and a way to look where it was lost. */

import { Button } from "react-aria-components";
import { plural, sentence } from "../state/format";
import { asVec3 } from "../state/vec";
import type { AbsentAirway } from "../wire/messages";
import { useApp, useStation } from "./context";
import { showPlace } from "./gestures-flat";

const NONE: readonly AbsentAirway[] = [];

export function AbsentAirways() {
  const station = useStation();
  const absent = useApp((state) => state.tree?.absent ?? NONE);
  if (absent.length === 0) return null;
  return (
    <details className="uncertain" data-testid="absent">
      <summary>{plural(absent.length, "bronchus", "bronchi")} not found</summary>
      <div className="places">
        <ul>
          {absent.map(({ name, reason, lps }) => (
            <li key={name}>
              {lps === null ? (
                <>
                  <span className="quiet">{`${name}: `}</span>
                  {sentence(reason)}
                </>
              ) : (
                <Button className="plain-text" onPress={() => showPlace(station, asVec3(lps), null)}>
                  <span className="quiet">{`${name}: `}</span>
                  {sentence(reason)}
                </Button>
              )}
            </li>
          ))}
        </ul>
      </div>
    </details>
  );
}
