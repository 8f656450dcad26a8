import { plural } from "../../state/format";
import { useApp, useStation } from "../context";
import { Act } from "../controls";
import { MaskPicker } from "../MaskImport";
import { PacsButton, PathForm, Pickers } from "../StartPage";

/** Render the panel of the Open step. */
export function OpenStep() {
  const station = useStation();
  const info = useApp((state) => state.session?.case ?? null);
  if (info === null) return null;
  const [nz = 0, ny = 0, nx = 0] = info.shape_zyx;
  const [sx = 0, sy = 0, sz = 0] = info.spacing_mm;
  return (
    <>
      <p>{info.title}</p>
      {info.ct_name === null ? null : <p className="quiet">CT: {info.ct_name}</p>}
      <dl className="facts">
        <div>
          <dt>Format</dt>
          <dd>{info.format}</dd>
        </div>
        <div>
          <dt>Size</dt>
          <dd className="numbers">
            {nx} {"\u00d7"} {ny} {"\u00d7"} {nz} voxels
          </dd>
        </div>
        <div>
          <dt>Spacing</dt>
          <dd className="numbers">
            {sx.toFixed(2)} {"\u00d7"} {sy.toFixed(2)} {"\u00d7"} {sz.toFixed(2)} mm
          </dd>
        </div>
        <div>
          <dt>Values</dt>
          <dd className="numbers">
            {Math.round(info.value_range[0] ?? 0)} to {Math.round(info.value_range[1] ?? 0)}
            {info.is_hu ? " HU" : ", not HU"}
          </dd>
        </div>
      </dl>
      {info.other_series.length === 0 ? null : (
        <p className="quiet">
          {plural(info.other_series.length, "other series", "other series")} in the folder: see Check.
        </p>
      )}
      <Act
        label="New case of this CT"
        words="Segment this CT again without your changes; this case stays in the list of recent cases"
        onPress={() => station.send({ type: "begin_anew" })}
      />
      <h3>Another segmentation</h3>
      <MaskPicker />
      <h3>Another case</h3>
      <p className="quiet">The current case stays open until the new one has loaded.</p>
      <Pickers />
      <PacsButton />
      <PathForm />
      <Act
        icon="folder"
        label="Start page"
        words="Close this case and go to recent cases and examples"
        onPress={() => station.send({ type: "close_case" })}
      />
    </>
  );
}
