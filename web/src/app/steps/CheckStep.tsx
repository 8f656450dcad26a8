import { keyOf, WINDOWS } from "../../input/keymap";
import { greyWindow } from "../../state/app-state";
import { findingsOf, notInStatement } from "../../state/badges";
import { sentence, windowText } from "../../state/format";
import { listsSeries } from "../../state/opening";
import type { CaseNote } from "../../wire/messages";
import { useApp, useStation } from "../context";
import { Act, Choice } from "../controls";
import { Icon } from "../icons";
import { SeriesList } from "../SeriesList";
import { CtStatementList } from "./CtStatementList";
import { SlicePlaces } from "./SlicePlaces";
import { Threshold } from "./Threshold";

const PRESETS = [
  { value: "window_lung", label: "Lung" },
  { value: "window_mediastinum", label: "Soft" },
  { value: "window_bone", label: "Bone" },
  { value: "window_airway", label: "Airway" },
] as const;
type PresetName = (typeof PRESETS)[number]["value"];

const SLABS = [
  { value: "thin", label: "Thin", mm: 0, kind: "min", words: "Single slice, no slab" },
  { value: "min", label: "Min", mm: 10, kind: "min", words: "10 mm slab MinIP: shows airways" },
  { value: "max", label: "Max", mm: 10, kind: "max", words: "10 mm slab MIP: shows vessels and nodules" },
  { value: "mean", label: "Mean", mm: 5, kind: "mean", words: "Mean over a slab of 5 mm (less noise)" },
] as const;
type SlabName = (typeof SLABS)[number]["value"];
const NO_BADGES: readonly CaseNote[] = [];

/** Render the panel of the Check step. */
export function CheckStep() {
  const station = useStation();
  const info = useApp((state) => state.session?.case ?? null);
  const badges = useApp((state) => state.session?.badges ?? NO_BADGES);
  const slab = useApp((state) => state.sight.slab);
  const width = useApp((state) => greyWindow(state).width_hu);
  const level = useApp((state) => greyWindow(state).level_hu);
  const pictures = useApp((state) => state.seriesPictures);
  // The series of a folder that is being opened are listed above; two lists could be confused.
  const isListing = useApp((state) => listsSeries(state.opening));
  if (info === null) return null;
  // The list of series states what this note states, with pictures.
  const warnings = info.notes.filter(({ code }) => code !== "import.several-series").map(({ words }) => words);
  const findings = findingsOf(badges, notInStatement(info.quality, info.statement), warnings);
  const isLimited = info.statement?.properties.some(({ limits }) => limits) ?? false;
  const reason = info.not_hu_reason ?? "this volume is not in Hounsfield units";
  const isListed = findings.some((words) => words.includes(reason));
  const chosen = PRESETS.find(({ value }) => WINDOWS[value].width_hu === width && WINDOWS[value].level_hu === level);
  return (
    <>
      {findings.length === 0 ? (
        isLimited ? null : (
          <p>No findings: the slices are complete and fine enough for the airways.</p>
        )
      ) : (
        <ul className="findings">
          {findings.map((words) => (
            <li key={words}>
              <Icon name="warning" />
              <span>{sentence(words)}</span>
            </li>
          ))}
        </ul>
      )}
      <SlicePlaces info={info} />
      {info.is_hu ? <CtStatementList statement={info.statement} /> : null}
      {info.is_hu ? null : (
        <>
          {isListed ? null : <p className="warning-text">{sentence(reason)}</p>}
          <Threshold />
        </>
      )}
      {info.off.length === 0 ? null : (
        <ul className="quiet-list">
          {info.off.map(({ what, why }) => (
            <li key={what}>
              {sentence(what)}: off{why === reason ? " without HU" : `, ${why}`}
            </li>
          ))}
        </ul>
      )}
      {info.other_series.length === 0 || isListing ? null : (
        <>
          <h3>Series in the folder</h3>
          <SeriesList
            key={info.number}
            series={info.series === null ? info.other_series : [info.series, ...info.other_series]}
            currentKey={info.series?.key ?? null}
            pictures={pictures}
            opening={null}
          />
        </>
      )}
      <h3>Window / level</h3>
      {info.is_hu ? (
        <Choice<PresetName | "own">
          name="Window / level"
          value={chosen?.value ?? "own"}
          choices={PRESETS.map(({ value, label }) => ({
            value,
            label,
            words: `${windowText(WINDOWS[value].width_hu, WINDOWS[value].level_hu)} HU`,
            keys: keyOf(value),
          }))}
          onChange={(value) => value !== "own" && station.act(value)}
        />
      ) : null}
      <p className="quiet numbers">
        {windowText(width, level)}
        {info.is_hu ? " HU" : ""}; drag with the right mouse button in a slice to change it
      </p>
      <h3>Slab thickness</h3>
      <Choice<SlabName>
        name="Slab thickness"
        value={
          SLABS.find((choice) => choice.mm === slab.thickness_mm && (choice.mm === 0 || choice.kind === slab.kind))
            ?.value ?? "thin"
        }
        choices={SLABS.map(({ value, label, words }) => ({ value, label, words, keys: keyOf("next_slab") }))}
        onChange={(value) => {
          const choice = SLABS.find((one) => one.value === value);
          if (choice !== undefined) station.send({ type: "set_slab", thickness_mm: choice.mm, kind: choice.kind });
        }}
      />
      <Act kind="primary" label="Continue to the airways" words="Next step" onPress={() => station.toStep("airways")} />
    </>
  );
}
