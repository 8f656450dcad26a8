/** List of the series in a folder or archive, open or being opened, with picture, facts and the likeliest chest CT. */

import { useEffect } from "react";
import { Button } from "react-aria-components";
import { sentence, seriesFacts, seriesTitle } from "../state/format";
import type { OtherSeries } from "../wire/messages";
import { useStation } from "./context";
import { Tip } from "./controls";
import { SeriesPicture } from "./SeriesPicture";

interface SeriesListProps {
  /** The series in the order of the list. */
  series: readonly OtherSeries[];
  /** Key of the series that is open or is being opened. */
  currentKey: string | null;
  /** Pictures of the series, PNG in base64, by key. */
  pictures: Readonly<Record<string, string>>;
  /** Job that opens one of the series, and its list; null for the folder of the open CT. */
  opening: { readonly jobId: string; readonly listId: string | null } | null;
}

/** Render the series of a folder; a click opens another one. */
export function SeriesList({ series, currentKey, pictures, opening }: SeriesListProps) {
  const station = useStation();
  const jobId = opening?.jobId ?? null;
  const listId = opening?.listId ?? null;
  useEffect(() => {
    station.send({ type: "ask_series_pictures", list_id: listId });
    return () => void station.send({ type: "stop_series_pictures" });
  }, [station, listId]);
  const row = (one: OtherSeries) => {
    const isCurrent = one.key === currentKey;
    const entry = <Entry series={one} picture={pictures[one.key] ?? null} state={stateText(isCurrent, jobId)} />;
    if (one.refused !== null) return <div className="series-row refused">{entry}</div>;
    if (isCurrent && jobId === null) return <div className="series-row open">{entry}</div>;
    const words =
      jobId === null
        ? `Open series ${one.key} instead; the present case stays in the list`
        : isCurrent
          ? "This series is being opened"
          : `Cancel the opening, and open series ${one.key} instead`;
    // The chosen series of an opening stays a button, so that the keyboard focus stays on the row that was pressed.
    return (
      <Tip words={words}>
        <Button
          className={isCurrent ? "series-row open" : "series-row"}
          aria-current={isCurrent ? "true" : undefined}
          onPress={() => {
            if (!isCurrent) station.send({ type: "open_series", key: one.key, job_id: jobId });
          }}
          data-testid={isCurrent ? "opening-series" : "open-series"}
        >
          {entry}
        </Button>
      </Tip>
    );
  };
  return (
    <ul className="series-list" data-testid="series-list" aria-label="Series in the folder">
      {series.map((one) => (
        <li key={one.key}>{row(one)}</li>
      ))}
    </ul>
  );
}

function stateText(isCurrent: boolean, jobId: string | null): string {
  if (!isCurrent) return "";
  return jobId === null ? " (open)" : " (being opened)";
}

function Entry({ series, picture, state }: { series: OtherSeries; picture: string | null; state: string }) {
  return (
    <>
      <SeriesPicture picture={picture} />
      <span className="case-words">
        <span className="case-name">
          {seriesTitle(series)}
          {state === "" ? null : <span className="quiet">{state}</span>}
        </span>
        <span className="numbers quiet">{seriesFacts(series)}</span>
        {series.likeliest === "" ? null : <span className="likeliest-reason">{sentence(series.likeliest)}</span>}
        {series.refused === null ? null : <span className="warning-text">{sentence(series.refused)}</span>}
      </span>
    </>
  );
}
