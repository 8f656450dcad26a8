import { beforeEach, describe, expect, it } from "vitest";
import { CLOSE_CODES, type PhoneStateMessage } from "../wire/messages";
import { checkPhoneMessage } from "../wire/parse";
import { Link, type LinkStatus } from "./link";
import { stateText } from "./texts";

const STATE: PhoneStateMessage = {
  type: "phone_state",
  case_open: true,
  control: "path",
  scope_held: false,
  holds: true,
  words: "",
};

class FakeSocket {
  binaryType = "";
  readyState = 0;
  bufferedAmount = 0;
  onopen: ((event: never) => void) | null = null;
  onmessage: ((event: never) => void) | null = null;
  onclose: ((event: never) => void) | null = null;
  readonly sent: string[] = [];
  closed = false;
  send(text: string): void {
    checkPhoneMessage(text);
    this.sent.push(text);
  }
  close(): void {
    this.closed = true;
  }
  opens(): void {
    this.readyState = 1;
    this.onopen?.(undefined as never);
  }
  receives(value: unknown): void {
    this.onmessage?.({ data: JSON.stringify(value) } as never);
  }
  ends(code: number): void {
    this.readyState = 3;
    this.onclose?.({ code } as never);
  }
}

let sockets: FakeSocket[];
let statuses: LinkStatus[];
let words: string;
let timers: { ms: number; call: () => void }[];
let link: Link;
const latestSocket = () => {
  const socket = sockets.at(-1);
  if (socket === undefined) throw new Error("no socket was made");
  return socket;
};

beforeEach(() => {
  sockets = [];
  statuses = [];
  timers = [];
  link = new Link(
    () => {
      sockets.push(new FakeSocket());
      return latestSocket();
    },
    "secret",
    {
      status: (status, text) => {
        statuses.push(status);
        words = text;
      },
      state: () => undefined,
    },
    (ms, call) => {
      const timer = { ms, call };
      timers.push(timer);
      return () => {
        timers = timers.filter((other) => other !== timer);
      };
    },
  );
  link.open();
});

describe("Link", () => {
  it("sends the token first, and no other message before the server has accepted the phone", () => {
    latestSocket().opens();
    expect(latestSocket().sent.map((text) => JSON.parse(text).token)).toEqual(["secret"]);
    expect(link.send({ type: "phone_act", action: "recenter" })).toBe(false);
    latestSocket().receives(STATE);
    expect(statuses.at(-1)).toBe("open");
    expect(link.send({ type: "phone_act", action: "recenter" })).toBe(true);
  });

  it("reconnects with doubled delays, and with the first delay after a successful connection", () => {
    latestSocket().ends(1006);
    expect(timers.map((timer) => timer.ms)).toEqual([500]);
    timers[0]?.call();
    latestSocket().ends(1006);
    expect(timers.map((timer) => timer.ms)).toEqual([1000]);
    timers[0]?.call();
    expect(sockets.length).toBe(3);
    latestSocket().opens();
    latestSocket().receives(STATE);
    latestSocket().ends(1006);
    expect(timers.at(-1)?.ms).toBe(500);
    expect(statuses.at(-1)).toBe("lost");
  });

  it("After a second open() the messages and the end of the first socket are ignored.", () => {
    const old = latestSocket();
    old.opens();
    link.open();
    expect([sockets.length, old.closed]).toEqual([2, true]);
    old.receives(STATE);
    expect(statuses.at(-1)).toBe("connecting");
    old.ends(1006);
    expect([statuses.at(-1), timers.length]).toEqual(["connecting", 0]);
    latestSocket().opens();
    latestSocket().receives(STATE);
    expect(statuses.at(-1)).toBe("open");
  });

  it.each(["protocol.not-authorised", "protocol.taken-over", "protocol.version", "protocol.malformed"] as const)(
    "does not reconnect after the close code %s",
    (code) => {
      latestSocket().opens();
      latestSocket().ends(CLOSE_CODES[code]);
      expect(statuses.at(-1)).toBe("refused");
      expect(words.length).toBeGreaterThan(20);
      expect(timers).toEqual([]);
    },
  );

  it("A message is discarded while the browser holds too many unsent bytes.", () => {
    latestSocket().opens();
    latestSocket().receives(STATE);
    latestSocket().bufferedAmount = 5000;
    expect(link.send({ type: "phone_act", action: "recenter" })).toBe(false);
    latestSocket().bufferedAmount = 0;
    expect(link.send({ type: "phone_act", action: "recenter" })).toBe(true);
  });

  it("An invalid message of the server closes the connection, and the status is refused.", () => {
    latestSocket().opens();
    const socket = latestSocket();
    socket.receives({ type: "phone_state", case_open: "yes" });
    expect(statuses.at(-1)).toBe("refused");
    expect(socket.closed).toBe(true);
  });
});

describe("stateText", () => {
  it("The text states the movement mode, that a case must be opened, or the server's reason.", () => {
    expect(stateText(STATE)).toBe("This phone moves the tip: path mode.");
    expect(stateText({ ...STATE, case_open: false })).toContain("Open a case");
    expect(stateText({ ...STATE, holds: false, scope_held: true })).toBe("Connected: scope mode.");
    expect(stateText({ ...STATE, words: "no path yet" })).toBe("no path yet");
  });
});
