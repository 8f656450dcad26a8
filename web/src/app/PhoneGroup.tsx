/** Settings of the phone page: its switch, its link as a QR code, and the certificate fingerprint to compare. */

import { fixed, plural } from "../state/format";
import { fingerprintLines, qrPath } from "../state/qr";
import type { DevicesMessage, PhoneInfo } from "../wire/messages";
import { useStation } from "./context";
import { SwitchKey } from "./controls";

/** Render the settings of the phone page: its switch, its link as a QR code, and the certificate fingerprint. */
export function PhoneGroup({ message }: { message: DevicesMessage }) {
  const station = useStation();
  const { phone } = message;
  return (
    <div className="group phone">
      <h3>Phone</h3>
      <SwitchKey
        words={
          phone === null
            ? "Opens a page on this network. Anyone with its link can move the tip, but cannot see the case."
            : "Closes the page; its link and certificate stop working"
        }
        label={phone === null ? "Use a phone" : "Close the phone page"}
        on={phone !== null}
        disabled={phone === null && message.phone_problem !== null}
        testId="phone-switch"
        onChange={() => station.send({ type: "set_phone", on: phone === null })}
      />
      {phone === null ? (
        <p className="quiet">
          {message.phone_problem ?? "A phone turns the tip and moves it forward and back, but not sideways."}
        </p>
      ) : (
        <Open phone={phone} />
      )}
    </div>
  );
}

function Open({ phone }: { phone: PhoneInfo }) {
  return (
    <>
      <p data-testid="phone-state">
        {phone.connected ? `Phone connected (${fixed(phone.rate_hz)} Hz).` : "Scan this with the phone's camera:"}
      </p>
      {phone.connected ? null : <Code rows={phone.qr} />}
      <p className="quiet path" data-testid="phone-url">
        {phone.url}
      </p>
      <p>
        The phone will warn about the certificate, because this computer issued it. Compare its fingerprint (SHA-256)
        before you continue:
      </p>
      <p className="fingerprint" data-testid="phone-sha256">
        {fingerprintLines(phone.sha256).map((line) => (
          <span key={line}>{line}</span>
        ))}
      </p>
      <p className="quiet">
        Listening on {phone.address}, encrypted. Anyone with this link can move the tip, but cannot see the case.
        {phone.num_refused === 0 ? "" : ` ${plural(phone.num_refused, "connection")} with an invalid link refused.`}
        {phone.num_bad === 0 ? "" : ` Messages ignored: ${phone.bad_words}.`}
      </p>
    </>
  );
}

function Code({ rows }: { rows: readonly string[] }) {
  const size = rows.length;
  return (
    <svg
      className="qr"
      viewBox={`0 0 ${size} ${size}`}
      shapeRendering="crispEdges"
      role="img"
      aria-label="The link as a QR code"
      data-testid="phone-qr"
    >
      <rect width={size} height={size} fill="#fff" />
      <path d={qrPath(rows)} fill="#000" />
    </svg>
  );
}
