import { describe, expect, it } from "vitest";
import { CLOSE_CODES, WIRE_VERSION } from "../wire/messages";
import { retryDelayMs, type Socket, Stream, type StreamStatus } from "./stream";

class FakeSocket implements Socket {
  binaryType = "";
  readyState = 0;
  onopen: ((event: never) => void) | null = null;
  onmessage: ((event: never) => void) | null = null;
  onclose: ((event: never) => void) | null = null;
  readonly sent: string[] = [];
  send(text: string) {
    this.sent.push(text);
  }
  close() {
    this.readyState = 3;
  }
  open() {
    this.readyState = 1;
    this.onopen?.({} as never);
  }
  say(data: unknown) {
    this.onmessage?.({ data } as never);
  }
  drop(code = 1006, reason = "") {
    this.readyState = 3;
    this.onclose?.({ code, reason } as never);
  }
}

function stream() {
  const sockets: FakeSocket[] = [];
  const statuses: StreamStatus[] = [];
  const faults: string[] = [];
  const messages: string[] = [];
  const due: { ms: number; call: () => void }[] = [];
  const made = new Stream(
    () => {
      const socket = new FakeSocket();
      sockets.push(socket);
      return socket;
    },
    {
      status: (status) => statuses.push(status),
      message: (message) => messages.push(message.type),
      picture: () => messages.push("picture"),
      fault: (words) => faults.push(words),
    },
    {
      nowMs: () => 1000,
      after: (ms, call) => {
        const entry = { ms, call };
        due.push(entry);
        return () => due.splice(due.indexOf(entry), 1);
      },
    },
  );
  return { made, sockets, statuses, faults, messages, due };
}

const HELLO = JSON.stringify({
  type: "hello",
  wire_version: WIRE_VERSION,
  carina_version: "0.1.0",
  watches: false,
  window: 1,
  at_machine: true,
});

describe("Stream", () => {
  it("sends hello first, and its status is open after the server's hello", () => {
    const { made, sockets, statuses } = stream();
    made.open();
    sockets[0]?.open();
    expect(JSON.parse(sockets[0]?.sent[0] ?? "")).toEqual({ type: "hello", wire_version: WIRE_VERSION });
    expect(statuses.map((entry) => entry.status)).toEqual(["connecting"]);
    sockets[0]?.say(HELLO);
    expect(statuses.at(-1)?.status).toBe("open");
  });

  it("reconnects with doubled delays up to a maximum, and with the first delay after a successful connection", () => {
    const { made, sockets, due } = stream();
    made.open();
    const waits: number[] = [];
    for (let attempt = 0; attempt < 7; attempt += 1) {
      sockets.at(-1)?.drop();
      const next = due.pop();
      waits.push(next?.ms ?? 0);
      next?.call();
    }
    expect(waits).toEqual([500, 1000, 2000, 4000, 8000, 8000, 8000]);
    sockets.at(-1)?.open();
    sockets.at(-1)?.say(HELLO);
    sockets.at(-1)?.drop();
    expect(due.pop()?.ms).toBe(retryDelayMs(0));
  });

  it("does not reconnect after a close code that only the user can resolve", () => {
    for (const name of ["protocol.too-many-windows", "protocol.not-authorised", "protocol.version"] as const) {
      const { made, sockets, statuses, due } = stream();
      made.open();
      sockets[0]?.drop(CLOSE_CODES[name]);
      expect(statuses.at(-1)?.status).toBe("refused");
      expect(due).toEqual([]);
      made.open();
      expect(sockets).toHaveLength(2);
    }
  });

  it("Messages and the end of a socket that was replaced are ignored.", () => {
    const { made, sockets, messages, statuses } = stream();
    made.open();
    made.open();
    sockets[0]?.say(HELLO);
    sockets[0]?.drop();
    expect(messages).toEqual([]);
    expect(statuses.every((entry) => entry.status === "connecting")).toBe(true);
  });

  it("A message without a connection is discarded, and send() returns false.", () => {
    const { made, sockets } = stream();
    made.open();
    expect(made.send({ type: "undo" })).toBe(false);
    sockets[0]?.open();
    expect(made.send({ type: "undo" })).toBe(true);
    expect(sockets[0]?.sent).toHaveLength(2);
  });

  it("numCommands counts the commands of the current connection only.", () => {
    const { made, sockets } = stream();
    made.open();
    made.send({ type: "undo" });
    sockets[0]?.open();
    made.send({ type: "undo" });
    made.send({ type: "ack", frame_id: 1 });
    made.send({ type: "set_fov", fov_deg: 90 });
    expect(made.numCommands).toBe(2);
    made.open();
    expect(made.numCommands).toBe(0);
  });

  it("An invalid message is reported, and the next valid message is handled.", () => {
    const { made, sockets, faults, messages } = stream();
    made.open();
    sockets[0]?.open();
    sockets[0]?.say('{"type":"nonsense"}');
    sockets[0]?.say(new ArrayBuffer(2));
    expect(faults).toHaveLength(2);
    sockets[0]?.say(HELLO);
    expect(messages).toEqual(["hello"]);
  });
});
