/**
 * Parser of the server's messages. It rejects everything that violates `protocol/schema.json`, which both languages
 * share, because a defective message must not cause a wrong picture.
 */

import schemaJson from "../../../protocol/schema.json";
import type { ClientMessage, PictureHeader, PictureLayer, ServerMessage, ToPhoneMessage } from "./messages";
import { clientProblem, doubledKey, layersOf, pictureProblem } from "./second-checks";

/** Error of a message that violates the protocol. */
export class WireError extends Error {}

/** The part of JSON Schema that the schema generator of the server uses. */
interface Schema {
  readonly $ref?: string;
  readonly const?: unknown;
  readonly enum?: readonly unknown[];
  readonly anyOf?: readonly Schema[];
  readonly oneOf?: readonly Schema[];
  readonly type?: string;
  readonly properties?: Readonly<Record<string, Schema>>;
  readonly required?: readonly string[];
  readonly additionalProperties?: boolean | Schema;
  readonly items?: Schema;
  readonly prefixItems?: readonly Schema[];
  readonly minItems?: number;
  readonly maxItems?: number;
  readonly minLength?: number;
  readonly maxLength?: number;
  readonly minimum?: number;
  readonly maximum?: number;
}

const DEFINITIONS = (schemaJson as unknown as { $defs: Readonly<Record<string, Schema>> }).$defs;

function definition(name: string): Schema {
  const found = DEFINITIONS[name];
  if (found === undefined) throw new WireError(`the schema has no ${name}`);
  return found;
}

function resolve(schema: Schema): Schema {
  return schema.$ref === undefined ? schema : definition(schema.$ref.replace("#/$defs/", ""));
}

/** Return the first violation of a schema by a value, as text; null for a valid value. */
function problem(given: Schema, value: unknown, where: string): string | null {
  const schema = resolve(given);
  if (schema.const !== undefined) return value === schema.const ? null : `${where} must be ${String(schema.const)}`;
  if (schema.enum !== undefined) return schema.enum.includes(value) ? null : `${where} is none of the known values`;
  if (schema.anyOf !== undefined) {
    let last: string | null = `${where} fits nothing`;
    for (const choice of schema.anyOf) {
      last = problem(choice, value, where);
      if (last === null) return null;
    }
    return last;
  }
  switch (schema.type) {
    case "null":
      return value === null ? null : `${where} must be null`;
    case "boolean":
      return typeof value === "boolean" ? null : `${where} must be true or false`;
    case "integer":
    case "number":
      return numberProblem(schema, value, where);
    case "string":
      return stringProblem(schema, value, where);
    case "array":
      return arrayProblem(schema, value, where);
    case "object":
      return objectProblem(schema, value, where);
    default:
      return `${where} has no rule`;
  }
}

function numberProblem(schema: Schema, value: unknown, where: string): string | null {
  if (typeof value !== "number" || !Number.isFinite(value)) return `${where} must be a finite number`;
  if (schema.type === "integer" && !Number.isInteger(value)) return `${where} must be a whole number`;
  if (schema.minimum !== undefined && value < schema.minimum) return `${where} is below ${schema.minimum}`;
  if (schema.maximum !== undefined && value > schema.maximum) return `${where} is above ${schema.maximum}`;
  return null;
}

function stringProblem(schema: Schema, value: unknown, where: string): string | null {
  if (typeof value !== "string") return `${where} must be text`;
  // Count code points, as Python does, and not UTF-16 units.
  const count = schema.minLength === undefined && schema.maxLength === undefined ? 0 : [...value].length;
  if (schema.minLength !== undefined && count < schema.minLength) return `${where} is too short`;
  if (schema.maxLength !== undefined && count > schema.maxLength) return `${where} is too long`;
  for (let index = 0; index < value.length; index += 1) {
    const code = value.charCodeAt(index);
    if (code < 0x20 && code !== 0x0a && code !== 0x09) return `${where} holds characters that no text has`;
  }
  return value.isWellFormed() ? null : `${where} holds characters that no text has`;
}

function arrayProblem(schema: Schema, value: unknown, where: string): string | null {
  if (!Array.isArray(value)) return `${where} must be a list`;
  if (schema.minItems !== undefined && value.length < schema.minItems) return `${where} has too few entries`;
  if (schema.maxItems !== undefined && value.length > schema.maxItems) return `${where} has too many entries`;
  for (let index = 0; index < value.length; index += 1) {
    const rule = schema.prefixItems?.[index] ?? schema.items;
    if (rule === undefined) continue;
    const found = problem(rule, value[index], `${where}[${index}]`);
    if (found !== null) return found;
  }
  return null;
}

function objectProblem(schema: Schema, value: unknown, where: string): string | null {
  if (typeof value !== "object" || value === null || Array.isArray(value)) return `${where} must be an object`;
  const fields = value as Record<string, unknown>;
  for (const name of schema.required ?? []) {
    if (!Object.hasOwn(fields, name)) return `${where} has no field ${name}`;
  }
  for (const [name, entry] of Object.entries(fields)) {
    const others = schema.additionalProperties;
    const rule = schema.properties?.[name] ?? (typeof others === "object" ? others : undefined);
    if (rule === undefined) {
      if (others === false) return `${where} has a field that is not known: ${name.slice(0, 40)}`;
      continue;
    }
    const found = problem(rule, entry, `${where}.${name}`);
    if (found !== null) return found;
  }
  return null;
}

/** Return the schema of each message type of a union, by the name of the type. */
function byType(union: string): ReadonlyMap<unknown, Schema> {
  return new Map(
    (definition(union).oneOf ?? []).map((choice) => {
      const schema = resolve(choice);
      return [schema.properties?.type?.const, schema];
    }),
  );
}

const SERVER_TYPES = byType("ServerMessage");
const CLIENT_TYPES = byType("ClientMessage");
const PHONE_TYPES = byType("PhoneMessage");
const TO_PHONE_TYPES = byType("ToPhoneMessage");

function parseMessage(types: ReadonlyMap<unknown, Schema>, text: string): unknown {
  const value = parseJson(text);
  if (doubledKey(text) !== null) throw new WireError("a message names the same field twice");
  if (typeof value !== "object" || value === null || Array.isArray(value)) {
    throw new WireError("a message must be a JSON object");
  }
  const type = (value as Record<string, unknown>).type;
  const schema = types.get(type);
  if (typeof type !== "string" || schema === undefined) throw new WireError("a message has a type that is not known");
  const found = problem(schema, value, type);
  if (found !== null) throw new WireError(found);
  return value;
}

function parseJson(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    throw new WireError("a message is not JSON");
  }
}

/** Parse a message of the server; throw a {@link WireError} if it violates the schema. */
export function parseServerMessage(text: string): ServerMessage {
  return parseMessage(SERVER_TYPES, text) as ServerMessage;
}

/** Check the text of a message from this client by the schema; throw a {@link WireError} if it violates the schema. */
export function checkClientMessage(text: string): void {
  const found = clientProblem(parseMessage(CLIENT_TYPES, text) as ClientMessage);
  if (found !== null) throw new WireError(found);
}

/** Parse a message of the server to the phone page; throw a {@link WireError} if it violates the schema. */
export function parseToPhone(text: string): ToPhoneMessage {
  return parseMessage(TO_PHONE_TYPES, text) as ToPhoneMessage;
}

/**
 * Check the text of a message from the phone page by the schema; throw a {@link WireError} if it violates the schema.
 */
export function checkPhoneMessage(text: string): void {
  parseMessage(PHONE_TYPES, text);
}

/** Maximum accepted length of a picture's header, bytes. */
const MAX_HEADER_BYTES = 65_536;

/** A received picture: header, image data, outline and layers. */
export interface WirePicture {
  readonly header: PictureHeader;
  readonly payload: Uint8Array<ArrayBuffer>;
  /** Lines of the lumen outline in the protocol's encoding; null if the picture has none. */
  readonly outline: Uint8Array<ArrayBuffer> | null;
  /** Lines of the lung structures around the targets. */
  readonly layers: readonly WireLayer[];
}

/** A layer of a received picture. */
export interface WireLayer {
  readonly header: PictureLayer;
  readonly bytes: Uint8Array<ArrayBuffer>;
}

/**
 * Parse the binary message of a picture: header length (u32, little-endian), JSON header, payload. Throw a {@link
 * WireError} if the message violates the protocol.
 */
export function parsePicture(data: ArrayBuffer): WirePicture {
  if (data.byteLength < 4) throw new WireError("an image message is truncated: it ends within its header");
  const headerBytes = new DataView(data).getUint32(0, true);
  if (headerBytes > MAX_HEADER_BYTES) throw new WireError("the header of a picture is too long");
  if (4 + headerBytes >= data.byteLength)
    throw new WireError("an image message is truncated: it ends before the image data");
  let text: string;
  try {
    text = new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(data, 4, headerBytes));
  } catch {
    throw new WireError("a picture's header is not UTF-8");
  }
  const header = parseJson(text);
  const found = problem(definition("PictureHeader"), header, "picture");
  if (found !== null) throw new WireError(found);
  const checked = header as PictureHeader;
  const rest = new Uint8Array(data, 4 + headerBytes);
  const wrong = pictureProblem(checked, rest);
  if (wrong !== null) throw new WireError(wrong);
  let end = rest.length;
  const before = (numBytes: number) => {
    end -= numBytes;
    return rest.subarray(end, end + numBytes);
  };
  const outline = checked.outline === null ? null : before(checked.outline.num_bytes);
  const layers = layersOf(checked)
    .toReversed()
    .map((header) => ({ header, bytes: before(header.num_bytes) }))
    .toReversed();
  return { header: checked, payload: rest.subarray(0, end), outline, layers };
}
