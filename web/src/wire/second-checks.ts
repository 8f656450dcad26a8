/** Checks that a schema cannot express: the "second checks" of `protocol/README.md`. */

import type { AskEditPreviewMessage, AskLivePathMessage, ClientMessage, PictureHeader, PictureLayer } from "./messages";

/**
 * Return the first key that occurs twice in one object of a JSON text; null if there is none. `JSON.parse` would use the
 * last value without an error.
 */
export function doubledKey(text: string): string | null {
  const objects: (Set<string> | null)[] = [];
  let index = 0;
  /** Whether the next string of the text is a key: in an object, a string after `{` or `,` is a key. */
  let keyDue = false;
  while (index < text.length) {
    const char = text[index];
    if (char === '"') {
      const end = endOfString(text, index);
      const keys = objects.at(-1);
      if (keyDue && keys != null) {
        const key: unknown = JSON.parse(text.slice(index, end));
        if (typeof key === "string") {
          if (keys.has(key)) return key;
          keys.add(key);
        }
        keyDue = false;
      }
      index = end;
      continue;
    }
    if (char === "{") {
      objects.push(new Set());
      keyDue = true;
    } else if (char === "[") {
      objects.push(null);
    } else if (char === "}" || char === "]") {
      objects.pop();
    } else if (char === ",") {
      keyDue = objects.at(-1) != null;
    }
    index += 1;
  }
  return null;
}

/** Return the index after the closing quote of the string that begins at `start`, in a valid JSON text. */
function endOfString(text: string, start: number): number {
  let index = start + 1;
  while (index < text.length && text[index] !== '"') index += text[index] === "\\" ? 2 : 1;
  return index + 1;
}

/** Return the first violation of the second checks by a client message, as text; null for a valid message. */
export function clientProblem(message: ClientMessage): string | null {
  switch (message.type) {
    case "layout":
      return new Set(message.views.map((entry) => entry.view)).size === message.views.length
        ? null
        : "layout names a view twice";
    case "device_sample":
      if ([message.axes, message.orientation_wxyz, message.handle].filter((kind) => kind !== null).length !== 1) {
        return "device_sample needs an orientation, axes or a handle";
      }
      return message.position_mm !== null && message.orientation_wxyz === null
        ? "device_sample has a position without an orientation"
        : null;
    case "add_target":
    case "arm_pen":
      return (message.cost ?? "lumen") === "lumen" && (message.root_lps ?? null) !== null
        ? `${message.type} has a start of its own, and a path through the lumen`
        : null;
    case "choose_route":
      return message.target_id !== null && message.branch_id !== null ? "choose_route has two destinations" : null;
    case "set_transfer":
      return (message.preset === null) === (message.document === null)
        ? "set_transfer needs a preset or a document"
        : null;
    case "preview_edit":
      if ((message.branch_id === null) === (message.tool === "move-fork")) {
        return "preview_edit must name a branch for move-fork, and only for move-fork";
      }
      return placeProblem(message);
    case "live_path":
      return placeProblem(message);
    default:
      return null;
  }
}

/** Return a text if a message contains neither or both of a point and a complete picture position; null otherwise. */
function placeProblem(message: AskLivePathMessage | AskEditPreviewMessage): string | null {
  const inPicture = [message.frame_id, message.column, message.row].filter((part) => part !== null).length;
  return inPicture === (message.lps === null ? 3 : 0) ? null : `${message.type} needs a point or a place in a picture`;
}

const PNG_MAGIC = [0x89, 0x50, 0x4e, 0x47];
const JPEG_MAGIC = [0xff, 0xd8, 0xff];

/**
 * Return the first violation in the payload of a picture, as text; null for a valid payload. The payload must begin with
 * the signature of its codec, and end with the complete lines of its outline and layers.
 */
export function pictureProblem(header: PictureHeader, payload: Uint8Array): string | null {
  const magic = header.codec === "png" ? PNG_MAGIC : JPEG_MAGIC;
  if (!magic.every((byte, index) => payload[index] === byte))
    return `the payload of an image message is not ${header.codec}`;
  let end = payload.length;
  for (const numBytes of [
    header.outline?.num_bytes ?? 0,
    ...layersOf(header)
      .map((layer) => layer.num_bytes)
      .reverse(),
  ]) {
    const wrong = linesProblem(payload, end, numBytes);
    if (wrong !== null) return wrong;
    end -= numBytes;
  }
  return null;
}

/** Return the layers of a picture; an empty list for the header of an older server, which has no layers. */
export const layersOf = (header: PictureHeader): readonly PictureLayer[] => header.layers ?? [];

function linesProblem(payload: Uint8Array, end: number, numBytes: number): string | null {
  if (numBytes >= end) return "the outline in an image message leaves no room for the image";
  let at = end - numBytes;
  while (at < end) {
    const count = (payload[at] ?? 0) + 256 * (payload[at + 1] ?? 0);
    at += 2 + 4 * count;
    if (count === 0 || at > end) return "the outline in an image message ends in the middle of a line";
  }
  return null;
}
