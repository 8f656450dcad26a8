/**
 * Panel of the lung structures around the target and of the reach of an instrument: buttons that compute, show and hide
 * them.
 */

import { sentence } from "../../state/format";
import { layerRows } from "../../state/lungs";
import { layerColour } from "../../views/overlay-layers";
import { useApp, useStation } from "../context";
import { Act, SwitchKey } from "../controls";
import { Icon } from "../icons";

/** Render the panel of the lung structures for a scope and a tool. */
export function LungsPanel({ scope, tool }: { scope: string; tool: string }) {
  const station = useStation();
  const lungs = useApp((state) => state.lungs);
  const found = useApp((state) => state.session?.airways === "found");
  const hidden = useApp((state) => state.ui.hiddenLayers);
  const title = useApp((state) => state.start?.scopes.find(({ name }) => name === scope)?.title ?? scope);
  if (!found) return null;
  const rows = layerRows(lungs);
  const mapping = lungs?.standing === "making";
  const reaching = lungs?.reach_standing === "making";
  return (
    <div className="lungs" data-testid="lungs">
      <h3>Around the target</h3>
      {lungs?.outdated === true ? (
        <p className="warning-text" data-testid="lungs-outdated">
          <Icon name="warning" /> The airways have changed. Compute these structures again.
        </p>
      ) : null}
      {(lungs?.problems ?? []).map((problem) => (
        <p key={problem} className="warning-text">
          <Icon name="warning" /> {sentence(problem)}
        </p>
      ))}
      {lungs?.standing === "had" ? null : (
        <Act
          label={mapping ? "Computing\u2026" : "Show vessels, lobes and stations"}
          words="Find vessels, fissures and lobes of both lungs, and place the EBUS stations (about a minute)"
          disabled={mapping}
          testId="map-lungs"
          onPress={() => station.send({ type: "map_lungs" })}
        />
      )}
      <Act
        kind="quiet"
        label={reaching ? "Mapping\u2026" : "Reach of this instrument"}
        words={`Map where in the lungs ${title} and its tool get to`}
        disabled={reaching}
        testId="map-reach"
        onPress={() => station.send({ type: "map_reach", scope, tool })}
      />
      {rows.length === 0 ? null : (
        <ul className="layers">
          {rows.map(({ layer, title: name, words, figures, limits, parts }) => (
            <li key={layer} data-testid={`layer-${layer}`}>
              <SwitchKey
                label={name}
                words={words}
                on={!hidden.includes(layer)}
                testId={`show-${layer}`}
                onChange={() => station.toggleLayer(layer)}
              />
              <details>
                <summary>
                  {parts.length === 0 ? <Swatch colour={layerColour(layer)} /> : null}
                  <span className="numbers">{figures}</span>
                </summary>
                {limits.map((limit) => (
                  <p key={limit} className="quiet">
                    {limit}
                  </p>
                ))}
                {layer === "stations" ? <Stations /> : null}
              </details>
              {parts.length === 0 ? null : (
                <ul className="parts" data-testid={`parts-${layer}`}>
                  {parts.map((part) => (
                    <li key={part}>
                      <Swatch colour={layerColour(layer, part)} />
                      {part}
                    </li>
                  ))}
                </ul>
              )}
            </li>
          ))}
        </ul>
      )}
      {rows.some(({ layer }) => layer === "vessels") ? (
        <p className="quiet" data-testid="lungs-limit">
          Vessels of the mediastinum and hila are not shown. Dashed: less sure.
        </p>
      ) : null}
    </div>
  );
}

/** Render a square in the colour of a layer. */
function Swatch({ colour }: { colour: string }) {
  return <span className="swatch" aria-hidden="true" style={{ background: colour }} />;
}

function Stations() {
  const stations = useApp((state) => state.lungs?.stations ?? null);
  const station = useStation();
  return (
    <ul className="stations">
      {(stations ?? []).map((one) => (
        <li key={one.words}>
          <span title={sentence(one.borders)}>{one.words}</span>
          {one.doubts.map((doubt) => (
            <span key={doubt} className="warning-text">
              {sentence(doubt)}
            </span>
          ))}
          {one.point_lps === null ? null : (
            <Act
              kind="quiet"
              label="Show"
              words={`Move the crosshair to where ${one.station} is looked for`}
              onPress={() => {
                const [x = 0, y = 0, z = 0] = one.point_lps ?? [];
                station.send({ type: "set_crosshair", lps: [x, y, z] });
              }}
            />
          )}
        </li>
      ))}
    </ul>
  );
}
