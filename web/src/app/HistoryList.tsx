/**
 * List of the commands executed on the case, latest last. A click on a step undoes the steps below it, or redoes the
 * steps up to it.
 */

import { useEffect, useRef } from "react";
import { Button } from "react-aria-components";
import { agoText, clock, sentence } from "../state/format";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";
import { ListHead } from "./ListHead";

/** Render the list of executed commands, with the undone commands marked. */
export function HistoryList() {
  const station = useStation();
  const history = useApp((state) => state.history);
  const begunS = useApp((state) => state.session?.saving.begun_s ?? null);
  const watches = useApp((state) => state.watches);
  const here = useRef<HTMLLIElement>(null);
  const step = history?.step ?? 0;
  // biome-ignore lint/correctness/useExhaustiveDependencies: the current row changes with each step
  useEffect(() => {
    // Do not return the result: in newer browsers it is a promise, which React would take for a cleanup function.
    here.current?.scrollIntoView({ block: "nearest" });
  }, [step]);
  const rows = [{ label: "Case opened", at_s: null }, ...(history?.steps ?? [])];
  return (
    <section className="branches history" aria-label="History">
      <ListHead />
      {rows.length === 1 ? (
        <p className="empty">
          Nothing has been changed yet. Your changes will be listed here; you can go back to any of them.
        </p>
      ) : (
        <ol className="history-rows" data-testid="history">
          {rows.map((row, n) => (
            // biome-ignore lint/suspicious/noArrayIndexKey: the position identifies a step
            <li key={n} ref={n === step ? here : undefined} data-undone={n > step || undefined}>
              <Tip words={n > step ? "Redo everything up to this point" : "Go back to this point"}>
                <Button
                  className="history-row"
                  aria-current={n === step ? "step" : undefined}
                  isDisabled={watches}
                  onPress={() => station.send({ type: "go_to_step", step: n })}
                >
                  <span>{sentence(row.label)}</span>
                  <span className="numbers quiet">
                    {row.at_s === null
                      ? ""
                      : begunS === null
                        ? agoText(row.at_s)
                        : clock(begunS + row.at_s, Date.now())}
                  </span>
                </Button>
              </Tip>
            </li>
          ))}
        </ol>
      )}
    </section>
  );
}
