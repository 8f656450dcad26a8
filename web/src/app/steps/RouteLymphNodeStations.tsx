/** Lymph node stations for EBUS along the selected route; a click shows the landmark of a station in the slices. */

import { Button } from "react-aria-components";
import { crosshairLps } from "../../state/app-state";
import { sentence } from "../../state/format";
import { isStationShown, stationText } from "../../state/plan";
import { asVec3 } from "../../state/vec";
import type { StationOnRoute, TargetPlan } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { giveKeysBack, Tip } from "../controls";
import { Icon } from "../icons";

/** Render the stations that the selected route passes or that are next to its target. */
export function RouteLymphNodeStations({ plan, note }: { plan: TargetPlan; note: string }) {
  return (
    <details className="turns" data-testid="route-stations" open>
      <summary>Lymph node stations (EBUS)</summary>
      {plan.stations.length === 0 ? (
        <p className="quiet">The route passes no landmark of a lymph node station, and none is next to the target.</p>
      ) : (
        <ol className="stations">
          {plan.stations.map((one, index) => (
            <Row key={`${one.station} ${one.head}`} one={one} number={index + 1} />
          ))}
        </ol>
      )}
      <p className="quiet">{note}</p>
    </details>
  );
}

function Row({ one, number }: { one: StationOnRoute; number: number }) {
  const station = useStation();
  const operator = useApp((state) => state.look.operator);
  const shown = useApp((state) => isStationShown(one, crosshairLps(state)));
  return (
    <li className={shown ? "chosen" : undefined}>
      <Tip words={`Show where station ${one.station} is examined in the slices. ${sentence(one.borders)}.`}>
        <Button
          className="turn"
          data-testid={`route-station-${number}`}
          onPress={(event) => {
            giveKeysBack(event.pointerType);
            station.send({ type: "set_crosshair", lps: asVec3(one.point_lps) });
          }}
        >
          {sentence(stationText(one, operator))}
        </Button>
      </Tip>
      {one.doubts.map((doubt) => (
        <span key={doubt} className="warning-text">
          <Icon name="warning" /> {sentence(doubt)}
        </span>
      ))}
    </li>
  );
}
