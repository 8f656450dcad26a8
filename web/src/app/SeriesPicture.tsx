/** Small picture of a series in a list. */

import { Icon } from "./icons";

/** Render a picture, a PNG in base64; a placeholder without one. */
export function SeriesPicture({ picture }: { picture: string | null }) {
  return (
    <span className="case-picture series-picture">
      {picture === null ? (
        <Icon name="file" />
      ) : (
        <img src={`data:image/png;base64,${picture}`} alt="" width={72} height={54} />
      )}
    </span>
  );
}
