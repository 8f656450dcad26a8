// Generated from python/carina/export/format_table.py by `python -m carina.server.wire.generate`. Do not edit.

/** Export formats by content: title, suffixes of the files, and the programs that read them. */
export const EXPORTS = [
  {
    title: "Airway surface",
    files: [
      { suffix: ".stl", words: "For 3D printing and most 3D software" },
      { suffix: ".ply", words: "For MeshLab and Blender" },
      { suffix: ".obj", words: "For 3D modelling software" },
      { suffix: ".glb", words: "For web and phone viewers" },
    ],
  },
  {
    title: "Lumen mask on the CT grid",
    files: [
      { suffix: ".nii.gz", words: "NIfTI for 3D Slicer, ITK-SNAP, Python" },
      { suffix: ".nii", words: "NIfTI, uncompressed" },
      { suffix: ".nrrd", words: "NRRD for 3D Slicer" },
      { suffix: ".mha", words: "MetaImage for ITK" },
    ],
  },
  {
    title: "Branches and centrelines",
    files: [
      { suffix: ".json", words: "The complete tree: names, radii, confidence" },
      { suffix: ".vtp", words: "For ParaView and VTK" },
      { suffix: ".mrk.json", words: "Curves for 3D Slicer" },
      { suffix: ".swc", words: "For software that analyses tree morphology" },
    ],
  },
] as const;
