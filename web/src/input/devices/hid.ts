/**
 * Location of axes and buttons in the reports of a HID device, from the descriptor that WebHID returns, and decoding of
 * their values.
 */

/** Usages of the Generic Desktop page (HID Usage Tables 1.4, page 0x01): X, Y, Z, Rx, Ry, Rz. */
export const AXIS_USAGES = [0x10030, 0x10031, 0x10032, 0x10033, 0x10034, 0x10035] as const;
/** Usage page of buttons (HID Usage Tables 1.4). */
const BUTTON_PAGE = 0x09;

/** The part of WebHID's `HIDReportItem` that Carina uses. */
export interface HidItem {
  readonly usages?: readonly number[];
  readonly usageMinimum?: number;
  readonly usageMaximum?: number;
  readonly isRange?: boolean;
  readonly reportSize?: number;
  readonly reportCount?: number;
  readonly logicalMinimum?: number;
  readonly logicalMaximum?: number;
  readonly isArray?: boolean;
}

/** The part of WebHID's `HIDCollectionInfo` that Carina uses. */
export interface HidCollection {
  readonly usagePage?: number;
  readonly usage?: number;
  readonly children?: readonly HidCollection[];
  readonly inputReports?: readonly { readonly reportId?: number; readonly items?: readonly HidItem[] }[];
}

/** Usage, location and range of one number in a report. */
export interface HidField {
  readonly usage: number;
  readonly bit: number;
  readonly size: number;
  readonly minimum: number;
  readonly maximum: number;
}

/** Return the fields of each input report, by report ID. */
export function fieldsOf(collections: readonly HidCollection[]): ReadonlyMap<number, readonly HidField[]> {
  const found = new Map<number, HidField[]>();
  const visit = (collection: HidCollection) => {
    for (const report of collection.inputReports ?? []) {
      const id = report.reportId ?? 0;
      let bit = 0;
      const fields: HidField[] = [];
      for (const item of report.items ?? []) {
        const size = item.reportSize ?? 0;
        const count = item.reportCount ?? 0;
        for (let n = 0; n < count; n += 1) {
          const usage = usageOf(item, n);
          if (usage !== null && size > 0 && size <= 32) {
            const minimum = item.logicalMinimum ?? 0;
            fields.push({ usage, bit, size, minimum, maximum: item.logicalMaximum ?? 0 });
          }
          bit += size;
        }
      }
      // A collection and its parent may list the same report; use the list with the most fields.
      if ((found.get(id)?.length ?? 0) < fields.length) found.set(id, fields);
    }
    for (const child of collection.children ?? []) visit(child);
  };
  for (const collection of collections) visit(collection);
  return found;
}

function usageOf(item: HidItem, n: number): number | null {
  if (item.isArray === true) return null;
  if (item.isRange === true || item.usageMinimum !== undefined) {
    const usage = (item.usageMinimum ?? 0) + n;
    return usage <= (item.usageMaximum ?? usage) ? usage : null;
  }
  const usages = item.usages ?? [];
  // If an item has fewer usages than fields, its last usage applies to the remaining fields.
  return usages[Math.min(n, usages.length - 1)] ?? null;
}

/**
 * Return the value of a field in a report, signed if the minimum in the descriptor is negative; null beyond the end of
 * the report.
 */
export function readField(data: DataView, field: HidField): number | null {
  let value = 0;
  for (let n = 0; n < field.size; n += 1) {
    const bit = field.bit + n;
    const byte = bit >> 3;
    if (byte >= data.byteLength) return null;
    if ((data.getUint8(byte) >> (bit & 7)) & 1) value += 2 ** n;
  }
  return field.minimum < 0 && value >= 2 ** (field.size - 1) ? value - 2 ** field.size : value;
}

/** Scale a value from the field's range to -1..1; the middle of the range is 0. */
export function scaled(value: number, field: HidField): number {
  const middle = (field.minimum + field.maximum) / 2;
  const half = (field.maximum - field.minimum) / 2;
  if (!(half > 0)) return 0;
  return Math.max(-1, Math.min(1, (value - middle) / half));
}

/** Return whether a usage is that of a button. */
export function isButton(usage: number): boolean {
  return usage >> 16 === BUTTON_PAGE;
}

/**
 * Return the bit of a pressed button in a sample: button 1 is bit 0. Return 0 for a released button, and for a button
 * beyond the 31 bits of a sample.
 */
export function buttonBit(field: HidField, value: number): number {
  const number = (field.usage & 0xffff) - 1;
  return value !== 0 && number >= 0 && number < 31 ? 1 << number : 0;
}
