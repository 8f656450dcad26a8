/** Display of a QR code and a certificate fingerprint. */

/** Return the dark modules of a QR code as one SVG path, with one rectangle per horizontal run. */
export function qrPath(rows: readonly string[]): string {
  return rows
    .flatMap((row, down) =>
      [...row.matchAll(/1+/g)].map((run) => `M${run.index} ${down}h${run[0].length}v1h-${run[0].length}z`),
    )
    .join("");
}

/** Number of byte pairs in a line of the fingerprint. */
const PAIRS_PER_LINE = 8;

/** Return a SHA-256 fingerprint in lines of eight byte pairs, similar to the layout on a phone. */
export function fingerprintLines(sha256: string): string[] {
  const pairs = sha256.split(":");
  const lines: string[] = [];
  for (let n = 0; n < pairs.length; n += PAIRS_PER_LINE) lines.push(pairs.slice(n, n + PAIRS_PER_LINE).join(" "));
  return lines;
}
