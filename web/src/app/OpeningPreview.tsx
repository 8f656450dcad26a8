/** CT that is being opened, below the progress: a preview of one slice, and the list of series to choose another. */

import { listsSeries, sliceText } from "../state/opening";
import type { OpeningSlice } from "../wire/messages";
import { useApp } from "./context";
import { SeriesList } from "./SeriesList";

/** Render the preview of the CT that is being opened; nothing without one. */
export function OpeningPreview() {
  const opening = useApp((state) => state.opening);
  if (opening === null) return null;
  const { message, pictures } = opening;
  const isListed = listsSeries(opening);
  return (
    <>
      {message.slice === null ? null : <PreviewSlice slice={message.slice} isSmall={isListed} />}
      {!isListed ? null : (
        <>
          <p className="quiet">
            The folder contains {message.series.length} series. Choose another one to open it instead.
          </p>
          {message.num_patients < 2 ? null : (
            <p className="warning-text">
              The series are of {message.num_patients} patients: check that the chosen one is of the right patient.
            </p>
          )}
          <SeriesList
            series={message.series}
            currentKey={message.chosen}
            pictures={pictures}
            opening={message.job_id === null ? null : { jobId: message.job_id, listId: message.list_id }}
          />
        </>
      )}
    </>
  );
}

function PreviewSlice({ slice, isSmall }: { slice: OpeningSlice; isSmall: boolean }) {
  const text = sliceText(slice);
  return (
    <figure className="opening-slice" data-testid="opening-slice">
      <div className={isSmall ? "opening-picture small" : "opening-picture"}>
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
