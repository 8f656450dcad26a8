/**
 * Pairs of route and instrument: the best pair with a button that takes it, and a table of the verdicts of all
 * instruments on the best routes, in which the user marks the instruments that are available here.
 */

import { Fragment } from "react";
import { sentence } from "../../state/format";
import {
  bestPair,
  type PairRow,
  pairedRoutes,
  pairRows,
  pairsText,
  routeNumber,
  withAvailable,
} from "../../state/route-pairs";
import type { PlansMessage, RoutePair, Target, TargetPlan } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { OUTCOME_MARKS } from "./outcome-marks";

/** Render the pairs of route and instrument of a target; nothing before the first verdict on a pair. */
export function RoutePairs({ target, plan, plans }: { target: Target; plan: TargetPlan; plans: PlansMessage }) {
  const station = useStation();
  const pairs = plans.pairs;
  if (pairs.length === 0) return null;
  const best = bestPair(pairs);
  const text = pairsText(plan, plans);
  const rows = pairRows(plan, pairs);
  const take = (pair: RoutePair) =>
    station.send({
      type: "choose_pair",
      target_id: target.target_id,
      route: pair.route,
      scope: pair.scope,
      tool: pair.tool,
    });
  return (
    <div className="pairs" data-testid="pairs">
      <h3>Best pair of route and instrument</h3>
      <p role="status" data-testid="best-pair">
        {text ?? "Comparing the instruments on the best routes\u2026"}
      </p>
      {best === null ? null : isChosen(plan, best) ? (
        <p className="quiet">This pair is taken.</p>
      ) : (
        <Act
          kind="plain"
          label="Take this pair"
          words={`Take ${best.title} and route ${routeNumber(plan, best)}`}
          testId="take-best-pair"
          onPress={() => take(best)}
        />
      )}
      <details className="plan-options">
        <summary>All pairs, and instruments available here</summary>
        <PairTable plan={plan} rows={rows} pairs={pairs} take={take} />
        {plans.pairs_standing === "making" ? <p className="quiet">{"Further verdicts follow\u2026"}</p> : null}
      </details>
    </div>
  );
}

/** Return whether a pair is the planned scope and tool on the chosen route. */
const isChosen = (plan: TargetPlan, pair: RoutePair): boolean =>
  plan.options.scope === pair.scope && plan.options.tool === pair.tool && plan.chosen === routeNumber(plan, pair);

interface TableProps {
  plan: TargetPlan;
  rows: readonly PairRow[];
  pairs: readonly RoutePair[];
  take: (pair: RoutePair) => void;
}

function PairTable({ plan, rows, pairs, take }: TableProps) {
  const station = useStation();
  const library = useApp((state) => state.start?.scopes ?? null)?.map((scope) => scope.name) ?? [];
  const available = useApp((state) => state.plans?.available ?? null);
  const routes = pairedRoutes(plan, pairs);
  const numbers = routes.map((route) => plan.routes.indexOf(route) + 1);
  const firstAbsent = rows.findIndex((row) => !row.available);
  return (
    <div className="routes-scroll">
      <table className="routes pair-table" data-testid="pair-table">
        <thead>
          <tr>
            <th scope="col">Available here</th>
            {numbers.map((number) => (
              <th scope="col" key={number}>
                Route {number}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {rows.map((row, n) => (
            <Fragment key={row.scope}>
              {n === firstAbsent ? (
                <tr>
                  <th scope="rowgroup" colSpan={1 + routes.length} className="quiet">
                    Not available here
                  </th>
                </tr>
              ) : null}
              <tr data-testid={`pair-row-${row.scope}`}>
                <th scope="row">
                  <label className="check">
                    <input
                      type="checkbox"
                      checked={row.available}
                      onChange={(event) =>
                        station.send({
                          type: "set_available_scopes",
                          scopes: withAvailable(library, available, row.scope, event.target.checked),
                        })
                      }
                    />
                    {row.title}
                  </label>
                </th>
                {row.cells.map((pair, column) => (
                  <td key={numbers[column]} className={pair !== null && isChosen(plan, pair) ? "chosen" : undefined}>
                    {pair === null ? null : (
                      <Act
                        kind="quiet"
                        label={
                          <span className={`verdict ${pair.outcome.replaceAll(" ", "-")}`}>
                            <span className="mark" aria-hidden="true">
                              {OUTCOME_MARKS[pair.outcome] ?? "?"}
                            </span>
                          </span>
                        }
                        words={`Take ${pair.title} and route ${numbers[column] ?? ""}. ${sentence(pair.words)}${pair.would === null ? "" : `. ${sentence(pair.would)}`}`}
                        testId={`pair-${pair.scope}-${numbers[column] ?? ""}`}
                        onPress={() => take(pair)}
                      />
                    )}
                  </td>
                ))}
              </tr>
            </Fragment>
          ))}
        </tbody>
      </table>
    </div>
  );
}
