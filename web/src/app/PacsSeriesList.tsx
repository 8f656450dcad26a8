/** List of the series of a study in a PACS, with picture, facts and the likeliest chest CT. */

import { Button } from "react-aria-components";
import { sentence } from "../state/format";
import { pacsSeriesText, patientText, studyText } from "../state/pacs";
import type { PacsStudyEntry } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
import { SeriesPicture } from "./SeriesPicture";

/** Render the series of a study; a click retrieves and opens one. */
export function PacsSeriesList({ name, study, onBack }: { name: string; study: PacsStudyEntry; onBack: () => void }) {
  const station = useStation();
  const answer = useApp((state) => state.pacs.series);
  const previews = useApp((state) => state.pacs.previews);
  const series = answer?.study_uid === study.study_uid ? answer.series : null;
  const first = answer?.preselected ?? null;
  // The likeliest series is the first of the list, because it is the one that the user usually opens.
  const ordered = [...(series ?? [])].sort((a, b) => Number(b.series_uid === first) - Number(a.series_uid === first));
  return (
    <section aria-label="Series of the study">
      <div className="row">
        <Act kind="quiet" icon="back" label="Results" words="Back to the found studies" onPress={onBack} />
        <span>
          <strong>{patientText(study.patient_name) || "No name"}</strong>{" "}
          <span className="quiet numbers">{studyText(study)}</span>
        </span>
      </div>
      {series === null ? (
        <p className="quiet">Reading the series…</p>
      ) : series.length === 0 ? (
        <p className="empty">The PACS lists no series of this study.</p>
      ) : (
        <ul className="pacs-list" data-testid="pacs-series">
          {ordered.map((one) => (
            <li key={one.series_uid}>
              <Tip words="Retrieve this series and open it">
                <Button
                  className={one.series_uid === first ? "recent-case likeliest" : "recent-case"}
                  isDisabled={one.modality !== "CT" && one.modality !== "MR"}
                  onPress={() =>
                    station.send({
                      type: "get_pacs_series",
                      name,
                      study_uid: study.study_uid,
                      series_uid: one.series_uid,
                    })
                  }
                >
                  <SeriesPicture picture={previews[one.series_uid]?.picture ?? null} />
                  <span className="case-words">
                    <span className="case-name">{one.description || `Series ${one.number ?? ""}`}</span>
                    <span className="numbers quiet">{pacsSeriesText(one, previews[one.series_uid])}</span>
                    {one.series_uid === first ? (
                      <span className="likeliest-reason">{sentence(answer?.reason ?? "")}</span>
                    ) : null}
                  </span>
                </Button>
              </Tip>
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}
