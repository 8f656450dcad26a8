/**
 * Parser of HID report descriptors for tests: converts the bytes of a descriptor to the collections that WebHID would
 * return. It implements the HID specification (1.11, section 6.2.2) for input reports, independently of the code under
 * test.
 */

import type { HidCollection, HidItem } from "./hid";

interface Mutable {
  usagePage: number;
  usage: number;
  children: Mutable[];
  inputReports: { reportId: number; items: HidItem[] }[];
}

/** Return the collections that WebHID would return for the bytes of a report descriptor. */
export function collectionsOf(bytes: Uint8Array): readonly HidCollection[] {
  const roots: Mutable[] = [];
  const open: Mutable[] = [];
  let [page, minimum, maximum, size, count, id] = [0, 0, 0, 0, 0, 0];
  let local: { usages: number[]; low: number | null; high: number | null } = { usages: [], low: null, high: null };
  const full = (usage: number) => page * 0x10000 + usage;
  let at = 0;
  while (at < bytes.length) {
    const prefix = bytes[at] ?? 0;
    const length = [0, 1, 2, 4][prefix & 3] ?? 0;
    let value = 0;
    for (let n = 0; n < length; n += 1) value += (bytes[at + 1 + n] ?? 0) * 256 ** n;
    const signed = length > 0 && value >= 2 ** (8 * length - 1) ? value - 2 ** (8 * length) : value;
    at += 1 + length;
    switch (prefix & 0xfc) {
      case 0x04:
        page = value;
        break;
      case 0x14:
        minimum = signed;
        break;
      case 0x24:
        // If the minimum is not negative, the maximum is unsigned: the bytes FF FF with a minimum of 0 are 65535.
        maximum = minimum < 0 ? signed : value;
        break;
      case 0x74:
        size = value;
        break;
      case 0x94:
        count = value;
        break;
      case 0x84:
        id = value;
        break;
      case 0x08:
        local.usages.push(full(value));
        break;
      case 0x18:
        local.low = full(value);
        break;
      case 0x28:
        local.high = full(value);
        break;
      case 0xa0: {
        const made: Mutable = {
          usagePage: page,
          usage: (local.usages[0] ?? 0) % 0x10000,
          children: [],
          inputReports: [],
        };
        (open.at(-1)?.children ?? roots).push(made);
        open.push(made);
        break;
      }
      case 0xc0:
        open.pop();
        break;
      case 0x80: {
        const root = open.at(-1);
        if (root === undefined) throw new Error("an input outside of any collection");
        let report = root.inputReports.find((each) => each.reportId === id);
        if (report === undefined) {
          report = { reportId: id, items: [] };
          root.inputReports.push(report);
        }
        const range = local.low !== null && local.high !== null;
        report.items.push({
          usages: (value & 1) === 1 ? [] : local.usages,
          ...(range ? { isRange: true, usageMinimum: local.low ?? 0, usageMaximum: local.high ?? 0 } : {}),
          isArray: (value & 2) === 0,
          reportSize: size,
          reportCount: count,
          logicalMinimum: minimum,
          logicalMaximum: maximum,
        });
        break;
      }
    }
    if ((prefix & 0x0c) === 0x00) local = { usages: [], low: null, high: null };
  }
  if (open.length > 0) throw new Error("a collection is not closed");
  return roots;
}
