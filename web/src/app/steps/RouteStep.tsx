import { routeDoubts, withError } from "../../state/branch-text";
import { mm } from "../../state/format";
import { planOf } from "../../state/plan";
import { placeText } from "../../state/route";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { SaveVideo } from "../FilmDialog";
import { SaveForks } from "../ForkSheet";
import { Icon } from "../icons";
import { LungsPanel } from "./LungsPanel";
import { PlannedRoutes } from "./PlannedRoutes";
import { useReachOf } from "./reach-of";
import { TargetList } from "./TargetStep";

/** Render the panel of the Route step. */
export function RouteStep() {
  const station = useStation();
  const route = useApp((state) => state.route);
  const targets = useApp((state) => state.session?.targets ?? null);
  const isSearched = (targets?.find((target) => target.target_id === route?.target_id)?.cost ?? "lumen") !== "lumen";
  const doubts = route === null ? null : routeDoubts(route);
  const known = route?.lumen_known ?? false;
  const plan = useApp((state) => planOf(state.plans, state.route?.target_id ?? null));
  const planned = targets?.find((target) => target.target_id === plan?.target_id) ?? null;
  const reach = useReachOf();
  const generation = known ? (route?.spans.at(-1)?.generation ?? null) : null;
  return (
    <>
      {planned !== null && plan !== null ? <PlannedRoutes target={planned} plan={plan} /> : null}
      {route === null ? (
        <p className="empty">No route yet. Choose a branch in the list above, or a target below.</p>
      ) : (
        <>
          {planned === null ? (
            <p>
              To <strong>{route.title}</strong>
            </p>
          ) : null}
          {doubts === null ? null : (
            <p className="warning-text" data-testid="route-doubts">
              <Icon name="warning" /> {doubts}
            </p>
          )}
          {known ? null : (
            <p className="quiet" data-testid="lumen-unknown">
              Tracked without an airway lumen: the calibre along this route is not known.
            </p>
          )}
          <dl className="facts">
            {planned !== null ? null : (
              <div>
                <dt>Length</dt>
                <dd className="numbers">{mm(route.length_mm, 0)}</dd>
              </div>
            )}
            {known ? (
              <div>
                <dt>Forks</dt>
                <dd className="numbers">{route.forks_mm.length}</dd>
              </div>
            ) : null}
            {generation === null ? null : (
              <div>
                <dt>Generation</dt>
                <dd className="numbers">{generation} (trachea is 0)</dd>
              </div>
            )}
            {!known || planned !== null ? null : (
              <div>
                <dt>Narrowest</dt>
                <dd className="numbers">
                  {route.narrowest_mm === null || route.narrowest_at_mm === null
                    ? isSearched
                      ? "not known: the path was not searched in the airways"
                      : "not measured yet"
                    : `${withError(route.narrowest_mm, route.narrowest_error_mm) ?? ""}, ${placeText(route, route.narrowest_at_mm)}`}
                </dd>
              </div>
            )}
          </dl>
        </>
      )}
      <LungsPanel scope={reach.scope} tool={reach.tool} />
      <Act
        kind={planned === null ? "primary" : "plain"}
        icon="play"
        label="Fly from the start"
        words="Go to the start of this route"
        disabled={route === null}
        onPress={() => {
          station.send({ type: "set_mode", mode: "path" });
          station.goTo(0);
        }}
      />
      <div className="row">
        <SaveVideo flight={{ kind: "route" }} testId="route-video" />
        <SaveForks />
      </div>
      {targets === null || targets.length === 0 ? null : <TargetList targets={targets} />}
    </>
  );
}
