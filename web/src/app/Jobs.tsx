/** Progress of long jobs of the server: a thin bar with title, fraction, remaining time and a cancel button. */

import { useState } from "react";
import { ProgressBar } from "react-aria-components";
import { plural, sentence, timeLeft } from "../state/format";
import { useApp, useStation } from "./context";
import { Act } from "./controls";
import { OpeningPreview } from "./OpeningPreview";

interface ThinProgressProps {
  title: string;
  what: string;
  fraction: number | null;
  secondsLeft: number | null;
  onCancel: () => void;
}

/** Render the title, progress bar and cancel button of one job. */
export function ThinProgress({ title, what, fraction, secondsLeft, onCancel }: ThinProgressProps) {
  // A cancelled job may first finish its current step. The bar stays until then and states that the job is being
  // cancelled.
  const [isCancelling, setCancelling] = useState(false);
  return (
    // biome-ignore lint/a11y/useSemanticElements: a field set is for the fields of a form
    <div className="job" role="group" aria-label={title}>
      <ProgressBar
        className="job-bar"
        aria-label={title}
        value={fraction ?? 0}
        maxValue={1}
        isIndeterminate={fraction === null}
      >
        <div className={fraction === null ? "unknown" : ""} style={{ width: `${100 * (fraction ?? 1)}%` }} />
      </ProgressBar>
      <div className="job-words">
        <span>
          {sentence(title)}
          {what === "" || what === title ? "" : `: ${what}`}
        </span>
        <span className="numbers quiet">
          {fraction === null ? "" : `${Math.floor(100 * fraction)} %`}
          {secondsLeft === null ? "" : `${fraction === null ? "" : ", "}${timeLeft(secondsLeft)}`}
        </span>
        <Act
          kind="quiet"
          label={isCancelling ? "Cancelling\u2026" : "Cancel"}
          words={`Cancel: ${title}`}
          disabled={isCancelling}
          onPress={() => {
            setCancelling(true);
            onCancel();
          }}
        />
      </div>
    </div>
  );
}

/** Render a progress bar for each running job. */
export function Jobs() {
  const station = useStation();
  const jobs = useApp((state) => state.jobs);
  const upload = useApp((state) => state.upload);
  const isOpening = useApp((state) => state.opening !== null);
  if (jobs.length === 0 && upload === null && !isOpening) return null;
  return (
    <div className="jobs">
      {/* Only the progress is read aloud when it changes, not the list of series below it. */}
      <div role="status">
        {upload === null ? null : (
          <ThinProgress
            title="Uploading the files"
            what={plural(upload.numFiles, "file")}
            fraction={upload.totalBytes > 0 ? upload.sentBytes / upload.totalBytes : null}
            secondsLeft={null}
            onCancel={station.transfers.cancelUpload}
          />
        )}
        {jobs.map((job) => (
          <ThinProgress
            key={job.job_id}
            title={job.title}
            what={job.what}
            fraction={job.fraction}
            secondsLeft={job.seconds_left}
            onCancel={() => station.send({ type: "cancel", job_id: job.job_id })}
          />
        ))}
      </div>
      <OpeningPreview />
    </div>
  );
}
