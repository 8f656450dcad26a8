/** Columns of the table that compares the targets of a case. */

import type { PlannedTargetRow } from "../wire/messages";
import { withError } from "./branch-text";
import { mm } from "./format";
import { figure, share, vesselCell } from "./plan";

/** Columns after the target's name, with the function that returns the text of each cell. */
export const COMPARED_COLUMNS: readonly { title: string; words: string; of: (row: PlannedTargetRow) => string }[] = [
  {
    title: "Outlook",
    words: "Whether the planned scope and tool reach the target by its best route",
    of: (r) => r.outlook,
  },
  {
    title: "Hits",
    words: "Share of needle passes that hit, by geometry and errors",
    of: (row) => figure(row.hit_share, share),
  },
  {
    title: "Narrowest",
    words: "Narrowest diameter of the whole way, with half of its 90\u202f% interval",
    of: (row) => figure(row.narrowest_mm, (least) => withError(least, row.narrowest_error_mm ?? 0) ?? ""),
  },
  {
    title: "Past carina",
    words: "Distance from the ridge of the main carina to the place where the scope stops",
    of: (row) => figure(row.from_carina_mm, (value) => mm(value, 0)),
  },
  {
    title: "Needle",
    words: "From the scope's tip to the target's edge",
    of: (row) => figure(row.to_target_mm, (value) => mm(value, 0)),
  },
  {
    title: "Vessel",
    words: "From the needle to the nearest visible vessel",
    of: (row) => (row.route === null ? figure(null, mm) : vesselCell(row.vessel_mm)),
  },
];
