import { keyOf } from "../../input/keymap";
import { useApp, useStation } from "../context";
import { Act } from "../controls";

/** What a person calls it, the file it becomes, and who reads that. */
const FILES: readonly (readonly [title: string, files: readonly (readonly [suffix: string, words: string])[]])[] = [
  [
    "Surface of the airways",
    [
      [".stl", "For 3D printing and most programs"],
      [".ply", "For MeshLab and Blender"],
      [".obj", "For drawing programs"],
      [".glb", "For viewers on the web and on phones"],
    ],
  ],
  [
    "Lumen on the CT's grid",
    [
      [".nii.gz", "NIfTI: 3D Slicer, ITK-SNAP, Python"],
      [".nrrd", "NRRD: 3D Slicer"],
      [".mha", "MetaImage: ITK"],
    ],
  ],
  [
    "Branches and centrelines",
    [
      [".json", "All that Carina knows of the tree: names, radii, confidence"],
      [".vtp", "For ParaView and VTK"],
      [".mrk.json", "Curves for 3D Slicer"],
      [".swc", "For programs of tree shapes"],
    ],
  ],
];

export function ShareStep() {
  const station = useStation();
  const found = useApp((state) => state.session?.airways === "found");
  const making = useApp((state) => state.ui.making);
  return (
    <>
      <p>{found ? "Files of the airways, as they are now." : "Files of the airways, once they are found."}</p>
      {FILES.map(([title, files]) => (
        <div key={title} className="group">
          <h3>{title}</h3>
          <div className="row">
            {files.map(([suffix, words]) => (
              <Act
                key={suffix}
                label={making === suffix ? "Making it\u2026" : suffix.replace(/^\./, "")}
                words={words}
                disabled={!found || making !== null}
                testId={`take${suffix}`}
                onPress={() => void station.takeAirways(suffix)}
              />
            ))}
          </div>
        </div>
      ))}
      <p className="quiet">
        In patient coordinates (LPS), mm. No name is in them, but anatomy can tell who it is: share them as you would
        share the CT.
      </p>
      <Act
        icon="capture"
        label="Key frames"
        words="Key frames for a smooth flight at a set speed: for a video"
        keys={keyOf("key_frames")}
        testId="to-keys"
        onPress={() => station.act("key_frames")}
      />
      <p className="quiet">
        A film: key frames, or a flight that is recorded under Rehearse. <kbd>carina fly</kbd> makes a video of either.
      </p>
    </>
  );
}
