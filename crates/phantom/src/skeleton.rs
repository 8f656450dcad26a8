//! Named branches of the phantom's airways: their directions and sizes.
//!
//! Lengths and diameters: PMC9929973, table 1 (docs/algorithms.md, sizes of airways). Directions are from this project,
//! LPS: -x is the patient's right, +y posterior, +z superior. The table measures a main bronchus from the carina's
//! ridge, which is some 9 mm below the point where the centrelines here separate, so the main bronchi here are longer
//! by that distance.

use crate::variants::Variants;

/// Named branch with its parent, direction, length and diameter.
pub(crate) struct Named {
    pub(crate) name: &'static str,
    pub(crate) parent: &'static str,
    pub(crate) dir: [f64; 3],
    pub(crate) length_mm: f64,
    pub(crate) diameter_mm: f64,
}

impl Named {
    /// Return true for a branch of one segment, such as RB1 or LB10, false for a common stem of two segments.
    ///
    /// LB1+2 is one segment of the left lung, and of both lungs in a left isomerism.
    pub(crate) fn is_segment(&self, variants: Variants) -> bool {
        let segment = self.name.starts_with("RB") || self.name.starts_with("LB");
        let is_left_pattern =
            self.name == "LB1+2" || self.name == "RB1+2" && variants.left_isomerism;
        segment && (is_left_pattern || !self.name.contains('+'))
    }
}

const fn named(
    name: &'static str,
    parent: &'static str,
    dir: [f64; 3],
    length_mm: f64,
    diameter_mm: f64,
) -> Named {
    Named {
        name,
        parent,
        dir,
        length_mm,
        diameter_mm,
    }
}

/// Variant of the division of the right upper lobe's bronchus.
///
/// The frequencies are 59, 18 and 9 % of 238 (Huang 2019); other divisions count as the first variant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RightUpper {
    Trifurcation,
    ApicalWithPosterior,
    PosteriorWithAnterior,
}

/// Variant of the division of a lower lobe's basal trunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Basal {
    Separate,
    LateralWithPosterior,
}

/// Divisions of the lobes' bronchi of one tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Divisions {
    pub(crate) right_upper: RightUpper,
    pub(crate) right_basal: Basal,
    pub(crate) left_basal: Basal,
}

/// Parent of a bronchus that leaves the trachea above the carina.
pub(crate) const UPPER_TRACHEA: &str = "Upper trachea";

/// Return every named branch below the trachea, parents before children.
///
/// If two branches have one name, the second continues the first, and later branches arise from the second.
pub(crate) fn named_branches(divisions: Divisions, variants: Variants) -> Vec<Named> {
    let mut all = if variants.left_isomerism {
        isomeric_right_lung(divisions.right_basal)
    } else {
        right_lung(divisions, variants)
    };
    all.extend(left_lung(divisions.left_basal));
    all
}

fn right_lung(divisions: Divisions, variants: Variants) -> Vec<Named> {
    let mut all = vec![
        named("RMB", "Trachea", [-0.52, 0.08, -0.85], 33.8, 15.4),
        named("RUL", "RMB", [-0.97, 0.10, 0.12], 16.7, 11.4),
        named("BI", "RMB", [-0.30, 0.16, -0.94], 22.3, 12.4),
    ];
    match divisions.right_upper {
        _ if variants.tracheal_bronchus => all.extend([
            // The length includes the radius of the trachea, in which the centreline starts.
            named("RB1", UPPER_TRACHEA, [-0.85, 0.02, 0.52], 28.0, 6.6),
            named("RB2", "RUL", [-0.55, 0.80, 0.25], 13.2, 7.0),
            named("RB3", "RUL", [-0.55, -0.82, 0.05], 14.6, 7.0),
        ]),
        RightUpper::Trifurcation => all.extend([
            named("RB1", "RUL", [-0.38, 0.02, 0.92], 15.0, 6.6),
            named("RB2", "RUL", [-0.62, 0.70, 0.34], 13.2, 7.0),
            named("RB3", "RUL", [-0.62, -0.77, 0.10], 14.6, 7.0),
        ]),
        RightUpper::ApicalWithPosterior => all.extend([
            named("RB1+2", "RUL", [-0.55, 0.40, 0.73], 8.0, 8.4),
            named("RB1", "RB1+2", [-0.30, -0.05, 0.95], 13.0, 6.4),
            named("RB2", "RB1+2", [-0.62, 0.76, 0.20], 12.2, 6.6),
            named("RB3", "RUL", [-0.62, -0.77, 0.10], 14.6, 7.0),
        ]),
        RightUpper::PosteriorWithAnterior => all.extend([
            named("RB1", "RUL", [-0.38, 0.02, 0.92], 15.0, 6.6),
            named("RB2+3", "RUL", [-0.98, 0.02, 0.10], 7.5, 8.4),
            named("RB2", "RB2+3", [-0.55, 0.80, 0.25], 12.2, 6.6),
            named("RB3", "RB2+3", [-0.55, -0.82, 0.05], 13.6, 6.8),
        ]),
    }
    all.extend([
        named("RML", "BI", [-0.55, -0.74, -0.38], 18.5, 8.6),
        named("RB4", "RML", [-0.90, -0.28, -0.32], 13.2, 6.3),
        named("RB5", "RML", [-0.52, -0.76, -0.40], 13.3, 6.4),
        named("RLL", "BI", [-0.28, 0.22, -0.93], 8.6, 11.6),
        named("RB6", "RLL", [-0.38, 0.91, 0.12], 12.0, 7.2),
    ]);
    let trunk = |parent: &'static str, length_mm: f64| {
        let dir = [-0.34, 0.12, -0.93];
        named("Right basal trunk", parent, dir, length_mm, 10.2)
    };
    if variants.subsuperior {
        // The trunk is longer than without this bronchus, which arises halfway between RB6 and the basal segments.
        all.extend([
            trunk("RLL", 9.5),
            named("RB*", "Right basal trunk", [-0.35, 0.87, -0.35], 11.0, 4.8),
            trunk("Right basal trunk", 8.0),
        ]);
    } else {
        all.push(trunk("RLL", 13.7));
    }
    if !variants.absent_rb7 {
        all.push(named(
            "RB7",
            "Right basal trunk",
            [0.12, -0.16, -0.98],
            13.9,
            5.6,
        ));
    }
    all.push(named(
        "RB8",
        "Right basal trunk",
        [-0.42, -0.66, -0.62],
        14.7,
        6.2,
    ));
    match divisions.right_basal {
        Basal::Separate => all.extend([
            named("RB9", "Right basal trunk", [-0.86, 0.10, -0.50], 13.1, 5.8),
            named("RB10", "Right basal trunk", [-0.22, 0.66, -0.72], 14.3, 6.4),
        ]),
        Basal::LateralWithPosterior => all.extend([
            named(
                "RB9+10",
                "Right basal trunk",
                [-0.55, 0.48, -0.68],
                7.5,
                7.6,
            ),
            named("RB9", "RB9+10", [-0.86, 0.05, -0.50], 12.1, 5.8),
            named("RB10", "RB9+10", [-0.18, 0.68, -0.71], 13.3, 6.2),
        ]),
    }
    all
}

fn left_lung(left_basal: Basal) -> Vec<Named> {
    let mut all = vec![
        named("LMB", "Trachea", [0.74, 0.13, -0.65], 55.8, 12.8),
        named("LUL", "LMB", [0.86, -0.48, 0.14], 14.0, 10.6),
        named("Upper division", "LUL", [0.52, -0.26, 0.81], 11.7, 9.2),
        named("LB1+2", "Upper division", [0.24, 0.42, 0.87], 12.9, 7.0),
        named("LB3", "Upper division", [0.52, -0.83, 0.18], 12.6, 6.8),
        named("Lingula", "LUL", [0.66, -0.60, -0.44], 13.5, 7.4),
        named("LB4", "Lingula", [0.93, -0.28, 0.05], 12.3, 6.0),
        named("LB5", "Lingula", [0.62, -0.62, -0.48], 14.8, 6.0),
        named("LLL", "LMB", [0.34, 0.30, -0.89], 11.0, 11.0),
        named("LB6", "LLL", [0.42, 0.90, 0.10], 12.7, 7.4),
        named("Left basal trunk", "LLL", [0.34, 0.12, -0.93], 15.7, 9.6),
        named("LB8", "Left basal trunk", [0.56, -0.52, -0.65], 14.7, 6.6),
    ];
    match left_basal {
        Basal::Separate => all.extend([
            named("LB9", "Left basal trunk", [0.86, 0.06, -0.50], 12.1, 5.9),
            named("LB10", "Left basal trunk", [0.16, 0.62, -0.77], 14.3, 6.6),
        ]),
        Basal::LateralWithPosterior => all.extend([
            named("LB9+10", "Left basal trunk", [0.52, 0.44, -0.73], 7.5, 7.6),
            named("LB9", "LB9+10", [0.86, 0.04, -0.50], 11.6, 5.8),
            named("LB10", "LB9+10", [0.12, 0.66, -0.74], 13.3, 6.2),
        ]),
    }
    all
}

/// Return the right lung of a left isomerism: the mirror image of the left lung, with two lobes.
fn isomeric_right_lung(basal: Basal) -> Vec<Named> {
    let right = |name: &'static str| match name {
        "LMB" => "RMB",
        "LUL" => "RUL",
        "Upper division" => "RB1+2+3",
        "LB1+2" => "RB1+2",
        "LB3" => "RB3",
        "Lingula" => "RB4+5",
        "LB4" => "RB4",
        "LB5" => "RB5",
        "LLL" => "RLL",
        "LB6" => "RB6",
        "Left basal trunk" => "Right basal trunk",
        "LB8" => "RB8",
        "LB9+10" => "RB9+10",
        "LB9" => "RB9",
        "LB10" => "RB10",
        other => other,
    };
    left_lung(basal)
        .into_iter()
        .map(|left| Named {
            name: right(left.name),
            parent: right(left.parent),
            dir: [-left.dir[0], left.dir[1], left.dir[2]],
            ..left
        })
        .collect()
}
