import { keyOf } from "../../input/keymap";
import { withError } from "../../state/branch-text";
import { fitOf, reachText, thatFit } from "../../state/fit";
import { fixed, mm } from "../../state/format";
import { placeText } from "../../state/route";
import type { HeldScope, RouteInfo, Scope } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { FlightList, RecordSwitch } from "../FlightList";
import { Icon } from "../icons";
import { ScopeSelect } from "../ScopeSelect";

/** Render the panel of the Rehearse step. */
export function RehearseStep() {
  const station = useStation();
  const route = useApp((state) => state.route);
  const scopes = useApp((state) => state.start?.scopes ?? null);
  const name = useApp((state) => state.look.scope);
  const held = useApp((state) => state.pose?.scope ?? null);
  if (route === null) {
    return <p className="empty">Rehearsal follows a route. Choose a branch in the list above, or mark a target.</p>;
  }
  if (!route.lumen_known) {
    return (
      <p className="empty">
        This route was tracked without an airway lumen: there is no wall to hold a bronchoscope. It can be flown along.
      </p>
    );
  }
  const scope = scopes?.find((each) => each.name === name) ?? null;
  const begin = (fromMm: number | null) => {
    // Leave scope mode and enter it again, so that the simulation restarts and counts contacts from 0.
    station.send({ type: "set_mode", mode: "path" });
    // Send the message now. station.goTo would send it at the next refresh, after scope mode has begun, and would end
    // that mode.
    if (fromMm !== null) station.send({ type: "go_to", path_mm: fromMm });
    station.send({ type: "set_mode", mode: "scope" });
  };
  return (
    <>
      <p>
        To <strong>{route.title}</strong>, with a simulated bronchoscope that bends, touches the wall and is stopped by
        it.
      </p>
      <ScopeSelect />
      <Act
        kind="primary"
        icon="play"
        label={held === null ? "Rehearse from the start" : "Begin again"}
        words="Insert the scope into the trachea at the start of the route"
        testId="rehearse"
        onPress={() => begin(0)}
      />
      <div className="row">
        {held === null ? (
          <Act
            label="From here"
            words="Insert the scope along the route up to the current tip position"
            onPress={() => begin(null)}
          />
        ) : (
          <Act
            label="End"
            words="Remove the scope and fly along the path again"
            onPress={() => station.send({ type: "set_mode", mode: "path" })}
          />
        )}
        <RecordSwitch />
      </div>
      <FlightList />
      <Act
        kind="quiet"
        icon="capture"
        label="Key frames"
        words="Views joined into a smooth flight at a set speed"
        keys={keyOf("key_frames")}
        onPress={() => station.act("key_frames")}
      />
      {scope === null || scopes === null ? (
        <p className="quiet">Choose a scope to see how far it reaches.</p>
      ) : (
        <Fit route={route} scope={scope} scopes={scopes} />
      )}
      {held === null ? null : <Score held={held} route={route} />}
      <p className="quiet">
        <kbd>W</kbd> <kbd>S</kbd> advance and withdraw, <kbd>{"\u2191"}</kbd> <kbd>{"\u2193"}</kbd> bend the tip,{" "}
        <kbd>A</kbd> <kbd>D</kbd> rotate. To use a gamepad, pen or scope handle, press <kbd>;</kbd>
      </p>
    </>
  );
}

/** Render whether the selected instrument passes the narrowest place of the route, and which instruments do. */
function Fit({ route, scope, scopes }: { route: RouteInfo; scope: Scope; scopes: readonly Scope[] }) {
  const fit = fitOf(route, scope.name);
  const passing = thatFit(route, scopes);
  const width = withError(route.narrowest_mm, route.narrowest_error_mm);
  const narrowest = route.narrowest_at_mm === null ? "" : placeText(route, route.narrowest_at_mm);
  return (
    <>
      <dl className="facts">
        <div>
          <dt>Tip</dt>
          <dd className="numbers">
            {mm(scope.tip_mm)}, needs a lumen of {mm(scope.fit_mm)}
          </dd>
        </div>
        {scope.channel_mm === null ? null : (
          <div>
            <dt>Channel</dt>
            <dd className="numbers">{mm(scope.channel_mm)}</dd>
          </div>
        )}
        <div>
          <dt>Scope reaches</dt>
          <dd className="numbers" data-testid="fits">
            {fit === null
              ? "not known until the airways are measured"
              : reachText(fit, placeText(route, route.length_mm), narrowest)}
          </dd>
        </div>
      </dl>
      {fit === null || fit === "fits" || width === null ? null : (
        <p className="warning-text">
          <Icon name="warning" /> The narrowest place, {narrowest}, is {width} wide.{" "}
          {passing.length > 0
            ? `These scopes pass it: ${passing.map((each) => `${each.title} (needs ${mm(each.fit_mm)})`).join("; ")}.`
            : "No listed scope certainly passes it."}
        </p>
      )}
    </>
  );
}

/** Render the counts and times of the rehearsal. */
function Score({ held, route }: { held: HeldScope; route: RouteInfo }) {
  return (
    <dl className="facts" data-testid="score">
      <div>
        <dt>Inserted</dt>
        <dd className="numbers">to {placeText(route, held.insertion_mm)}</dd>
      </div>
      <div>
        <dt>Wall contacts</dt>
        <dd className="numbers">
          {held.num_contacts} ({fixed(held.contact_s, 1)} s)
        </dd>
      </div>
    </dl>
  );
}
