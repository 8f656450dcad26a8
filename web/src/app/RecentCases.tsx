/**
 * List of the recently used cases, each with its picture, last use and number of changes. A case that the user has not
 * named has a neutral alias.
 */

import { Button } from "react-aria-components";
import { caseFacts, RECENT_SHOWN } from "../state/case-list";
import type { RecentCase } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Act, Tip } from "./controls";
import { Icon } from "./icons";

const NONE: readonly RecentCase[] = [];

/** Render the most recent cases on the start page, with a button that opens the list of all. */
export function RecentCases() {
  const station = useStation();
  const recent = useApp((state) => state.start?.recent ?? NONE);
  const more = recent.length - RECENT_SHOWN;
  return (
    <>
      <div className="recent-head">
        <h2>Recent cases</h2>
        <Act
          kind="quiet"
          label={more > 0 ? `All ${recent.length} cases and storage` : "Cases and storage"}
          words="Rename or delete cases, and see how much disk space they use"
          testId="open-storage"
          onPress={() => {
            station.send({ type: "ask_storage" });
            station.ui({ storageOpen: true });
          }}
        />
      </div>
      {recent.length === 0 ? (
        <p className="empty">The cases you open appear here, without the names of their CT files.</p>
      ) : (
        <ul className="recent" data-testid="recent">
          {recent.slice(0, RECENT_SHOWN).map((entry) => (
            <li key={entry.recent_id}>
              {entry.opens ? (
                <Tip words={entry.num_changes === null ? "Open this CT again" : "Continue this case"}>
                  <Button
                    className="recent-case"
                    onPress={() => station.send({ type: "open_recent", recent_id: entry.recent_id })}
                  >
                    <CaseText entry={entry} all={recent} />
                  </Button>
                </Tip>
              ) : (
                <div className="recent-case closed">
                  <CaseText entry={entry} all={recent} />
                </div>
              )}
            </li>
          ))}
        </ul>
      )}
    </>
  );
}

/** Render the picture, the title, and the facts that distinguish a case from the other cases. */
export function CaseText({ entry, all }: { entry: RecentCase; all: readonly RecentCase[] }) {
  return (
    <>
      <CasePicture entry={entry} />
      <span className="case-words">
        <span className="case-name">{entry.title}</span>
        <span className="numbers quiet">{caseFacts(entry, all, Date.now()).join(" \u00b7 ")}</span>
        {entry.opens ? null : <span className="warning-text">Open its CT to continue.</span>}
      </span>
    </>
  );
}

/** Render the stored picture of a case, or a placeholder if it has none. */
export function CasePicture({ entry }: { entry: RecentCase }) {
  return (
    <span className="case-picture">
      {entry.picture === null ? <Icon name="file" /> : <img src={`./${entry.picture}`} alt="" width={80} height={60} />}
    </span>
  );
}
