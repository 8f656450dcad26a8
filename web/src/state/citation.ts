/** A citation as one line, for display under a picture. */

import type { Citation } from "../wire/messages";

/** Return a citation as one line of text. */
export const citationLine = (from: Citation): string =>
  `${from.authors} (${from.year}). ${from.title}. ${from.publisher}. https://doi.org/${from.doi} \u00b7 ` +
  `Licence: ${from.licence}. Changed: ${from.changes}.`;
