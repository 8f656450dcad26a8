/** A citation in two short lines; the whole text is always one press away. */

export interface ShortCitation {
  /** Collection and licence. */
  source: string;
  doi: string | null;
}

export function shortCitation(text: string): ShortCitation {
  const collection = /Data From ([\w -]+)\./.exec(text)?.[1]?.replaceAll("_", " ");
  const licence = /CC BY(?:-[A-Z]+)* \d\.\d/.exec(text)?.[0];
  const doi = /doi\.org\/(\S+?)[.,;]?(?:\s|$)/.exec(text)?.[1] ?? null;
  const known = [collection, licence].filter((part) => part !== undefined);
  return { source: known.length === 0 ? "Source and licence" : known.join(", "), doi };
}
