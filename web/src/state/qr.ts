/** How a QR code and a fingerprint are shown. */

/** The dark modules as one SVG path, a rectangle for each run. */
export function qrPath(rows: readonly string[]): string {
  return rows
    .flatMap((row, down) =>
      [...row.matchAll(/1+/g)].map((run) => `M${run.index} ${down}h${run[0].length}v1h-${run[0].length}z`),
    )
    .join("");
}

const PAIRS_PER_LINE = 8;

/** In lines of eight pairs, as a phone shows it in about the same places. */
export function fingerprintLines(sha256: string): string[] {
  const pairs = sha256.split(":");
  const lines: string[] = [];
  for (let n = 0; n < pairs.length; n += PAIRS_PER_LINE) lines.push(pairs.slice(n, n + PAIRS_PER_LINE).join(" "));
  return lines;
}
