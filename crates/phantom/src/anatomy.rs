//! Fixed anatomy of the phantom round the lungs: great vessels, spine, ribs, sternum; LPS mm, the carina is the origin.
//!
//! The structures are plain shapes at plausible positions. They serve as landmarks in the picture and as difficulties
//! for an airway search; they are not part of the ground truth.

use crate::shapes::{Piece, add, mix};

/// Tissue of a solid structure of the phantom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Tissue {
    /// Soft tissue (vessels, oesophagus, muscle) with one value in HU throughout.
    Soft(f64),
    /// Bone with a cortical shell of 1.5 mm round marrow.
    Bone,
}

/// Solid structure of the phantom: a piece of a tube of one tissue.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Solid {
    pub(crate) piece: Piece,
    pub(crate) tissue: Tissue,
}

/// Return the y coordinate of the centre of the vertebral bodies at a height z (the thoracic kyphosis), LPS mm.
pub(crate) fn spine_y(z: f64) -> f64 {
    let u = z + 60.0;
    53.0 - 0.00085 * u * u
}

/// Height of one vertebra with its disc, mm.
pub(crate) const VERTEBRA_MM: f64 = 24.0;

fn chain(out: &mut Vec<Solid>, tissue: Tissue, points: &[([f64; 3], f64)]) {
    for w in points.windows(2) {
        out.push(Solid {
            piece: Piece {
                start: w[0].0,
                end: w[1].0,
                start_radius: w[0].1,
                end_radius: w[1].1,
            },
            tissue,
        });
    }
}

/// Return heart, great vessels and oesophagus of the mediastinum, and the bones except the vertebral bodies.
pub(crate) fn solids(rib_cage: impl Fn(f64, f64) -> [f64; 2]) -> Vec<Solid> {
    let mut out = Vec::new();
    great_vessels(&mut out);
    posterior_spine(&mut out);
    for side in [-1.0, 1.0] {
        ribs(&mut out, side, &rib_cage);
        // Clavicle.
        let at = |x: f64, y: f64, z: f64| [side * x, y, z];
        chain(
            &mut out,
            Tissue::Bone,
            &[
                (at(16.0, -62.0, 66.0), 7.0),
                (at(50.0, -66.0, 76.0), 5.0),
                (at(95.0, -40.0, 92.0), 5.5),
                (at(125.0, -18.0, 100.0), 6.0),
            ],
        );
    }
    out
}

fn great_vessels(out: &mut Vec<Solid>) {
    let blood = Tissue::Soft(44.0);
    // Aorta: ascending, arch over the left main bronchus, descending along the spine.
    chain(
        out,
        blood,
        &[
            ([2.0, -30.0, -46.0], 15.0),
            ([-12.0, -34.0, -8.0], 15.0),
            ([-6.0, -31.0, 16.0], 14.0),
            ([10.0, -20.0, 30.0], 13.0),
            ([24.0, -4.0, 30.0], 12.5),
            ([28.0, 16.0, 18.0], 12.5),
            ([27.0, 30.0, -6.0], 12.0),
            ([24.0, 36.0, -60.0], 11.5),
            ([16.0, 33.0, -200.0], 10.5),
        ],
    );
    // Superior vena cava and brachiocephalic veins.
    chain(
        out,
        blood,
        &[
            ([-24.0, -24.0, -40.0], 9.0),
            ([-24.0, -26.0, 30.0], 8.5),
            ([-26.0, -28.0, 62.0], 7.0),
            ([-36.0, -26.0, 112.0], 6.0),
        ],
    );
    chain(
        out,
        blood,
        &[
            ([-22.0, -28.0, 42.0], 6.5),
            ([10.0, -42.0, 54.0], 6.5),
            ([34.0, -34.0, 70.0], 6.0),
            ([42.0, -26.0, 112.0], 6.0),
        ],
    );
    // Branches of the arch.
    chain(
        out,
        blood,
        &[
            ([0.0, -30.0, 30.0], 6.5),
            ([-14.0, -27.0, 66.0], 6.0),
            ([-24.0, -24.0, 112.0], 4.5),
        ],
    );
    chain(
        out,
        blood,
        &[
            ([14.0, -18.0, 36.0], 4.5),
            ([20.0, -20.0, 70.0], 4.0),
            ([25.0, -24.0, 112.0], 4.0),
        ],
    );
    chain(
        out,
        blood,
        &[
            ([25.0, -2.0, 36.0], 5.0),
            ([27.0, -2.0, 62.0], 4.5),
            ([50.0, -8.0, 82.0], 4.5),
        ],
    );
    // Pulmonary trunk, left artery over the left main bronchus, right artery in front of the carina.
    chain(
        out,
        blood,
        &[
            ([18.0, -52.0, -46.0], 14.0),
            ([23.0, -36.0, -16.0], 13.5),
            ([30.0, -16.0, -6.0], 11.5),
            ([44.0, 2.0, -16.0], 10.0),
            ([50.0, 12.0, -40.0], 8.0),
        ],
    );
    chain(
        out,
        blood,
        &[
            ([20.0, -36.0, -22.0], 12.0),
            ([-4.0, -25.0, -26.0], 10.5),
            ([-30.0, -14.0, -32.0], 9.5),
            ([-37.0, -6.0, -48.0], 7.5),
        ],
    );
    // Inferior vena cava and the left atrium's body across the midline.
    chain(
        out,
        blood,
        &[([-22.0, -14.0, -92.0], 11.0), ([-24.0, -2.0, -200.0], 11.0)],
    );
    // Oesophagus, collapsed, because air in it would look like a second trachea.
    chain(
        out,
        Tissue::Soft(34.0),
        &[
            ([3.0, 0.0, 112.0], 6.0),
            ([4.0, 14.0, 40.0], 6.5),
            ([3.0, 21.0, 0.0], 6.5),
            ([6.0, 27.0, -50.0], 7.0),
            ([14.0, 14.0, -150.0], 7.5),
        ],
    );
}

/// Add the processes of the vertebrae and the heads of the ribs, behind the vertebral bodies.
fn posterior_spine(out: &mut Vec<Solid>) {
    let mut level = -216.0;
    while level < 130.0 {
        let y = spine_y(level);
        for side in [-1.0, 1.0] {
            chain(
                out,
                Tissue::Bone,
                &[
                    ([side * 11.0, y + 12.0, level], 4.5),
                    ([side * 12.0, y + 24.0, level - 3.0], 5.0),
                    ([0.0, y + 32.0, level - 8.0], 4.0),
                ],
            );
            chain(
                out,
                Tissue::Bone,
                &[
                    ([side * 12.0, y + 24.0, level - 2.0], 5.0),
                    ([side * 32.0, y + 28.0, level], 4.5),
                ],
            );
        }
        chain(
            out,
            Tissue::Bone,
            &[
                ([0.0, y + 32.0, level - 8.0], 4.0),
                ([0.0, y + 52.0, level - 22.0], 3.5),
            ],
        );
        level += VERTEBRA_MM;
    }
}

/// Add eleven ribs of one side, with the cartilage of the first seven.
///
/// `rib_cage(azimuth, z)` is the pleura in a direction (0 = posterior, pi = anterior) as `[x >= 0, y]`.
fn ribs(out: &mut Vec<Solid>, side: f64, rib_cage: &impl Fn(f64, f64) -> [f64; 2]) {
    for i in 0..11 {
        let n = f64::from(i);
        let head_z = 72.0 - VERTEBRA_MM * n;
        let drop = 26.0 + 8.0 * n.min(7.0);
        // The last ribs end in the flank.
        let turn = if i < 7 {
            2.55 - 0.04 * n
        } else {
            2.2 - 0.22 * (n - 7.0)
        };
        let place = |t: f64| {
            let z = head_z + 4.0 - drop * t * t.mul_add(0.3, 0.7);
            let [x, y] = rib_cage(mix(0.24, turn, t), z);
            // The offset is 7 mm outside the pleura, for rib and intercostal muscle.
            let far = (x * x + y * y).sqrt().max(1.0);
            [side * x * (1.0 + 7.0 / far), y * (1.0 + 7.0 / far), z]
        };
        let mut points = vec![([side * 18.0, spine_y(head_z) + 10.0, head_z], 4.0)];
        let num = 16;
        points.extend((0..=num).map(|s| (place(f64::from(s) / f64::from(num)), 4.8)));
        chain(out, Tissue::Bone, &points);
        if i < 7 {
            let end = points[points.len() - 1].0;
            let sternum_z = 46.0 - 17.0 * n;
            let front = rib_cage(core::f64::consts::PI, sternum_z)[1] - 9.0;
            let middle = add(
                [side * 9.0, 0.5 * (front - end[1]) - 3.0, -2.0],
                [0.5 * end[0], end[1], 0.5 * (end[2] + sternum_z)],
            );
            chain(
                out,
                Tissue::Soft(95.0),
                &[
                    (end, 4.8),
                    (middle, 5.0),
                    ([side * 15.0, front, sternum_z], 5.0),
                ],
            );
        }
    }
}
