/** Preview of a CT that is being opened, below the progress of its job. */

import { sliceText } from "../state/opening";
import type { OpeningSlice } from "../wire/messages";
import { useApp } from "./context";

/** Render the preview of the CT that a job opens; nothing for other jobs. */
export function OpeningPreview({ jobId }: { jobId: string }) {
  const opening = useApp((state) => (state.opening?.job_id === jobId ? state.opening : null));
  return opening === null || opening.slice === null ? null : <PreviewSlice slice={opening.slice} />;
}

function PreviewSlice({ slice }: { slice: OpeningSlice }) {
  const text = sliceText(slice);
  return (
    <figure className="opening-slice" data-testid="opening-slice">
      <div className="opening-picture">
        <img
          src={`data:image/png;base64,${slice.picture}`}
          alt={`Preview of the CT: ${text}`}
          style={{ aspectRatio: `${slice.width_mm} / ${slice.height_mm}` }}
        />
        {/* The picture is seen from the feet, as the axial view is. */}
        <span aria-hidden="true">R</span>
        <span aria-hidden="true">L</span>
      </div>
      <figcaption>
        <strong className="warning-text">Preview: the CT is still being opened</strong>
        <span className="numbers">{text}</span>
        <span className="quiet">{slice.is_hu ? "Axial, lung window" : "Axial, grey range of this slice"}</span>
      </figcaption>
    </figure>
  );
}
