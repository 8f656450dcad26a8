/** List of the series in the folder or archive of the open CT, with picture, facts and the likeliest chest CT. */

import { useEffect } from "react";
import { Button } from "react-aria-components";
import { sentence, seriesFacts, seriesTitle } from "../state/format";
import type { CaseInfo, OtherSeries } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";
import { SeriesPicture } from "./SeriesPicture";

/** Render the series of the folder: the open one first, then the others; a click opens another one. */
export function SeriesList({ info }: { info: CaseInfo }) {
  const station = useStation();
  const number = info.number;
  useEffect(() => {
    if (number === 0) return;
    station.send({ type: "ask_series_pictures" });
    return () => void station.send({ type: "stop_series_pictures" });
  }, [station, number]);
  return (
    <ul className="series-list" data-testid="series-list">
      {info.series === null ? null : (
        <li className="series-row open">
          <Entry series={info.series} isOpen />
        </li>
      )}
      {info.other_series.map((series) => (
        <li key={series.key}>
          {series.refused === null ? (
            <Tip words={`Open series ${series.key} instead; the present case stays in the list`}>
              <Button
                className="series-row"
                onPress={() => station.send({ type: "open_series", key: series.key })}
                data-testid="open-series"
              >
                <Entry series={series} />
              </Button>
            </Tip>
          ) : (
            <div className="series-row refused">
              <Entry series={series} />
            </div>
          )}
        </li>
      ))}
    </ul>
  );
}

function Entry({ series, isOpen = false }: { series: OtherSeries; isOpen?: boolean }) {
  const picture = useApp((state) => state.seriesPictures[series.key] ?? null);
  return (
    <>
      <SeriesPicture picture={picture} />
      <span className="case-words">
        <span className="case-name">
          {seriesTitle(series)}
          {isOpen ? <span className="quiet"> (open)</span> : null}
        </span>
        <span className="numbers quiet">{seriesFacts(series)}</span>
        {series.likeliest === "" ? null : <span className="likeliest-reason">{sentence(series.likeliest)}</span>}
        {series.refused === null ? null : <span className="warning-text">{sentence(series.refused)}</span>}
      </span>
    </>
  );
}
