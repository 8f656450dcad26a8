/**
 * Settings of the watcher page: its switch, its link, the certificate fingerprint to compare, and the current watchers.
 */

import { clock, plural } from "../state/format";
import { fingerprintLines } from "../state/qr";
import type { WatchPage } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, SwitchKey } from "./controls";

/** Render the settings of the watcher page: its switch, its link, the certificate fingerprint, and the watchers. */
export function WatchGroup() {
  const station = useStation();
  const watching = useApp((state) => state.watching);
  const page = watching?.page ?? null;
  const problem = watching?.problem ?? null;
  return (
    <div className="group phone">
      <h3>Watchers</h3>
      <SwitchKey
        words={
          page === null
            ? "Opens a page on this network. Anyone with the link can see your patient's images but cannot change anything."
            : "Closes the page and disconnects all watchers; its link stops working"
        }
        label={page === null ? "Let others watch" : "Close the watch page"}
        on={page !== null}
        disabled={page === null && problem !== null}
        testId="watch-switch"
        onChange={() => station.send({ type: "set_watch_page", on: page === null, learners: false })}
      />
      {page === null ? (
        <p className="quiet">
          {problem ?? "Others on this network can follow the case in a browser until you close the case."}
        </p>
      ) : (
        <Open page={page} />
      )}
    </div>
  );
}

function Open({ page }: { page: WatchPage }) {
  const station = useStation();
  return (
    <>
      <p className="warning-text">Your patient's images are on the network: anyone with this link can see them.</p>
      <p>Send this link to everyone who should watch:</p>
      <p className="quiet path" data-testid="watch-url">
        {page.url}
      </p>
      <p>
        Their browser will warn about the certificate, because this computer issued it. Have them compare its
        fingerprint (SHA-256):
      </p>
      <p className="fingerprint" data-testid="watch-sha256">
        {fingerprintLines(page.sha256).map((line) => (
          <span key={line}>{line}</span>
        ))}
      </p>
      <SwitchKey
        words={
          page.learners
            ? "Stops sending the learners of this machine to the watchers"
            : "For a teacher: sends the pseudonyms, attempts and scores of all learners to everyone with the link"
        }
        label="Teacher's view: share the learners"
        on={page.learners}
        testId="watch-learners"
        onChange={() => station.send({ type: "set_watch_page", on: true, learners: !page.learners })}
      />
      {page.watchers.length === 0 ? (
        <p className="quiet">No observers are connected yet.</p>
      ) : (
        <ul className="watchers" data-testid="watchers">
          {page.watchers.map((watcher) => (
            <li key={watcher.number}>
              <span>
                {watcher.address} <span className="quiet">since {clock(watcher.since_s, Date.now())}</span>
              </span>
              <Act
                kind="quiet"
                label="Disconnect"
                words="Ends this connection and changes the link, so that nobody can reconnect with the old one"
                onPress={() => station.send({ type: "send_away", number: watcher.number })}
              />
            </li>
          ))}
        </ul>
      )}
      {page.num_refused === 0 ? null : (
        <p className="quiet">{plural(page.num_refused, "connection")} with an invalid link refused.</p>
      )}
    </>
  );
}
