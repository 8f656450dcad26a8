import { readdirSync, readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, it } from "vitest";
import { checkClientMessage, checkPhoneMessage, parsePicture, parseServerMessage, parseToPhone } from "./parse";

const SAMPLES = fileURLToPath(new URL("../../../protocol/", import.meta.url));

function samples(folder: string): { name: string; bytes: Uint8Array<ArrayBuffer> }[] {
  return readdirSync(`${SAMPLES}${folder}`).map((name) => {
    const file = readFileSync(`${SAMPLES}${folder}/${name}`);
    return { name, bytes: new Uint8Array(file) };
  });
}

const text = (bytes: Uint8Array): string => new TextDecoder().decode(bytes);
const refused = (read: () => unknown): boolean => {
  try {
    read();
    return false;
  } catch {
    return true;
  }
};

describe("samples of the protocol", () => {
  it("Each folder contains at least four samples, because an empty folder would pass every test.", () => {
    for (const folder of ["valid/server", "valid/client", "valid/pictures", "invalid/server", "invalid/client"]) {
      expect(samples(folder).length).toBeGreaterThan(3);
    }
  });

  it.each(samples("valid/server"))("parseServerMessage accepts the server's message $name.", ({ bytes }) => {
    expect(parseServerMessage(text(bytes))).toEqual(JSON.parse(text(bytes)));
  });

  it.each(samples("valid/client"))("checkClientMessage accepts the client's message $name.", ({ bytes }) => {
    expect(() => checkClientMessage(text(bytes))).not.toThrow();
  });

  it.each(samples("valid/pictures"))("parsePicture accepts the picture $name.", ({ bytes }) => {
    const { header, payload } = parsePicture(bytes.buffer);
    expect(header.width).toBeGreaterThan(0);
    expect(payload.length).toBeGreaterThan(0);
  });

  it.each(samples("invalid/server"))("parseServerMessage rejects the server's message $name.", ({ bytes }) => {
    expect(refused(() => parseServerMessage(text(bytes)))).toBe(true);
  });

  it.each(samples("invalid/client"))("checkClientMessage rejects the client's message $name.", ({ bytes }) => {
    expect(refused(() => checkClientMessage(text(bytes)))).toBe(true);
  });

  it.each(samples("valid/phone"))("checkPhoneMessage accepts the phone's message $name.", ({ bytes }) => {
    expect(() => checkPhoneMessage(text(bytes))).not.toThrow();
  });

  it.each(samples("valid/to-phone"))("parseToPhone accepts the message to the phone $name.", ({ bytes }) => {
    expect(parseToPhone(text(bytes))).toEqual(JSON.parse(text(bytes)));
  });

  it.each(samples("invalid/phone"))("checkPhoneMessage rejects the phone's message $name.", ({ bytes }) => {
    expect(refused(() => checkPhoneMessage(text(bytes)))).toBe(true);
  });

  it.each(samples("invalid/to-phone"))("parseToPhone rejects the message to the phone $name.", ({ bytes }) => {
    expect(refused(() => parseToPhone(text(bytes)))).toBe(true);
  });

  it.each(samples("invalid/pictures"))("parsePicture rejects the picture $name.", ({ bytes }) => {
    expect(refused(() => parsePicture(bytes.buffer))).toBe(true);
  });
});
