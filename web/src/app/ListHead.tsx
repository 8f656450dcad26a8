/** Head of the list in the left column, with the tabs that switch between airways and history. */

import type { ReactNode } from "react";
import { Button } from "react-aria-components";
import { keyOf } from "../input/keymap";
import { useApp, useStation } from "./context";
import { Tip } from "./controls";

const LISTS = [
  { list: "airways", title: "Airways", words: "The branches of the airway tree" },
  { list: "history", title: "History", words: "Edit history: return to any step" },
] as const;

/** Render the head of the list in the left column; `children` are its further buttons. */
export function ListHead({ children }: { children?: ReactNode }) {
  const station = useStation();
  const shown = useApp((state) => state.ui.list);
  return (
    <h2 className="list-head">
      {LISTS.map(({ list, title, words }) => (
        <Tip key={list} words={words} keys={list === "history" ? keyOf("history") : undefined}>
          <Button
            className="list-choice"
            aria-label={`${title} list`}
            aria-pressed={list === shown}
            data-testid={`list-${list}`}
            onPress={() => station.ui({ list })}
          >
            {title}
          </Button>
        </Tip>
      ))}
      {children}
    </h2>
  );
}
