/**
 * List of the places where an airway continues but the search could not follow it, each with its reason and a button
 * that shows the place.
 */

import { Button } from "react-aria-components";
import { plural, sentence } from "../state/format";
import { groupsOf } from "../state/uncertain";
import { asVec3, type Vec3 } from "../state/vec";
import type { UncertainPlace } from "../wire/messages";
import { useApp, useStation } from "./context";
import { showPlace } from "./gestures-flat";

const NONE: readonly UncertainPlace[] = [];

/**
 * Render a button that adds the suggested bridge at a place. The edit is the same as with the bridge tool, and can be
 * undone in the same way.
 */
function BridgeButton({ beyond }: { beyond: Vec3 }) {
  const station = useStation();
  return (
    <Button
      className="plain-text bridge"
      onPress={() => station.send({ type: "edit_tree", edit: { kind: "bridge", lps: beyond } })}
    >
      Bridge
    </Button>
  );
}

/** Render the list of places that the search could not follow; nothing if there are none. */
export function UncertainPlaces() {
  const station = useStation();
  const places = useApp((state) => state.tree?.uncertain ?? NONE);
  const tree = useApp((state) => state.tree);
  if (places.length === 0) return null;
  return (
    <details className="uncertain" name="doubts" data-testid="uncertain">
      <summary>Airway lost at {plural(places.length, "place")}</summary>
      <div className="places">
        {groupsOf(places).map(({ why, places: members }) => (
          <section key={members[0]?.place.lps.join(" ")}>
            {why === null ? null : <p className="quiet">{sentence(why)}</p>}
            <ul>
              {members.map(({ place, words }) => (
                <li key={place.lps.join(" ")}>
                  <Button
                    className="plain-text"
                    onPress={() => {
                      showPlace(station, asVec3(place.lps), place.branch_id);
                      if (place.branch_id !== null) station.ui({ selected: place.branch_id });
                    }}
                    onHoverChange={(on) => station.pointing.hoverBranch(on ? place.branch_id : null)}
                  >
                    <span className="quiet">
                      {place.branch_id === null ? "" : `${tree?.byId.get(place.branch_id)?.label ?? ""}: `}
                    </span>
                    {why === null ? sentence(words) : words}
                  </Button>
                  {place.beyond_lps === null ? null : <BridgeButton beyond={asVec3(place.beyond_lps)} />}
                </li>
              ))}
            </ul>
          </section>
        ))}
      </div>
    </details>
  );
}
