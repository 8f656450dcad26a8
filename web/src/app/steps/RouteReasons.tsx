/** List of reasons against a planned route: doubts about its branches, and limits of scope and tool. */

import { sentence } from "../../state/format";
import type { RouteOffer } from "../../wire/messages";
import { Icon } from "../icons";

/** Render the reasons against a route; nothing without a reason. */
export function RouteReasons({ route }: { route: RouteOffer | null }) {
  const why = route?.narrowest_why ?? null;
  const unmeasured = why === null || route?.limits.some((limit) => limit.includes(why)) ? null : why;
  return (
    <>
      {(route?.doubts ?? []).map((doubt) => (
        <p key={doubt} className="error-text" data-testid="route-doubt">
          <Icon name="warning" /> {sentence(doubt)}
        </p>
      ))}
      {(route?.limits ?? []).map((limit) => (
        <p key={limit} className="warning-text">
          <Icon name="warning" /> {sentence(limit)}
        </p>
      ))}
      {unmeasured === null ? null : (
        <p className="warning-text" data-testid="route-unmeasured">
          <Icon name="warning" /> {sentence(unmeasured)}
        </p>
      )}
    </>
  );
}
