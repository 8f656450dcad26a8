/** Selection of the instrument: its optics show the airway view, and the plans of all targets use it. */

import { Button, ListBox, ListBoxItem, Popover, Select, SelectValue } from "react-aria-components";
import { fixed } from "../state/format";
import { trainingLayout } from "../state/training";
import type { Scope } from "../wire/messages";
import { useApp, useStation } from "./context";
import { Tip, useKeysBack } from "./controls";
import { Icon } from "./icons";

const NO_SCOPE = "no scope";

/** Return the tip diameter and the field of view of an instrument as text. */
function sizeText(scope: Scope): string {
  const fov = scope.fov_deg === null ? "" : `, ${fixed(scope.fov_deg)}\u00b0`;
  return `\u2300 ${fixed(scope.tip_mm, 1)} mm${fov}`;
}

/**
 * Return the first word of an instrument's title, because the toolbar is narrow; the list and the tooltip show the full
 * title.
 */
const shortTitle = (title: string): string => title.split(/[ ,(]/)[0] ?? title;

/** Render the selection of the instrument; nothing until the server has sent its instruments. */
export function ScopeSelect() {
  const station = useStation();
  const scopes = useApp((state) => state.start?.scopes ?? null);
  const name = useApp((state) => state.look.scope);
  const hasPlans = useApp((state) => state.session?.targets.some((target) => target.has_size) === true);
  // Another instrument would end the attempt at a task.
  const trains = useApp((state) => trainingLayout(state) !== undefined);
  const keysBack = useKeysBack();
  if (scopes === null) return null;
  const chosen = scopes.find((scope) => scope.name === name);
  const plans = hasPlans ? "The plans use this scope as well." : "Plans for targets will use this scope as well.";
  const words =
    chosen === undefined
      ? "No scope: pinhole camera. The scope of the plans does not change."
      : `Viewed through: ${chosen.title}, ${sizeText(chosen)}. ${plans}`;
  return (
    <Select
      aria-label="Scope"
      className="select scope"
      isDisabled={trains}
      onOpenChange={keysBack.onOpenChange}
      selectedKey={name ?? NO_SCOPE}
      onSelectionChange={(key) => {
        const scope = key === NO_SCOPE ? null : String(key);
        if (key !== null && scope !== name) station.send({ type: "set_scope", scope });
      }}
    >
      <Tip words={words}>
        <Button className="button" data-testid="scope" onPressStart={keysBack.onPressStart}>
          <SelectValue>{() => (chosen === undefined ? "No scope" : shortTitle(chosen.title))}</SelectValue>
          <Icon name="down" />
        </Button>
      </Tip>
      <Popover className="popover" offset={4}>
        <ListBox className="listbox scopes">
          {scopes.map((scope) => (
            <ListBoxItem key={scope.name} id={scope.name} textValue={scope.title} className="listbox-item">
              <span>{scope.title}</span>
              <span className="item-words numbers">{sizeText(scope)}</span>
            </ListBoxItem>
          ))}
          <ListBoxItem id={NO_SCOPE} textValue="No scope" className="listbox-item">
            <span>No scope</span>
            <span className="item-words">pinhole</span>
          </ListBoxItem>
        </ListBox>
      </Popover>
    </Select>
  );
}
