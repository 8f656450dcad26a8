//! From the lumen that the flood found on into the airways that it could not follow (docs/algorithms.md).
//!
//! The flood ends where an airway's wall no longer holds a level. What lies beyond is looked for by shape, not by level:
//! voxels that are enclosed by brighter wall ([`crate::find::tubeness`]) are followed from the lumen's surface, face to face.
//! How enclosed a voxel must be is read off the volume itself: lung away from the airways shows what noise, texture and vessels
//! pretend. At most a fiftieth of it passes, far below the share (31 % of a cubic lattice joined by faces) at which
//! passing voxels would join into ways of any length if they lay about by chance. An edge-enhancing kernel arranges them in
//! sheets (docs/decisions/0113), so a search that reaches too much of the lung is given up.
//!
//! Of what was reached, paths are kept: from the lumen, along the most enclosed voxels, to the farthest tips, the longest
//! first, cut where following them no longer pays. A path that is short, or not clearly better than lung, goes. Round a
//! kept path the lumen is what is darker than half-way up to its wall there.

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::find::extension_levels::Levels;
pub use crate::find::extension_levels::{Divided, EXTENDED, ExtensionLimits, Followed};
use crate::find::extension_reach::{open_from, reach};
use crate::find::extension_ways::Search;
use crate::find::tubeness::{Enclosure, REACH_MM, smoothed};
use carina_leastcost::{TrackError, Watch};

/// What the extension found.
#[derive(Debug, Clone, PartialEq)]
pub struct Extension {
    /// Kept paths, parents before what leaves them.
    pub followed: Vec<Followed>,
    /// Voxels that joined the lumen.
    pub num_voxels: usize,
    /// How far values must rise round a voxel, in the volume's numbers: what 98 % of the lung does not reach.
    pub enclosed: f64,
    /// Voxels that could be followed from the lumen's surface, before paths were judged.
    pub num_reached: usize,
    /// It reached more of the lung than airways can, and was given up: nothing was added.
    pub ran_out: bool,
}

/// Extends `lumen` (1 inside, 0 outside; face-connected) in place: what is added gets [`EXTENDED`].
pub fn extend(
    values: VolumeView<'_, i16>,
    lumen: &mut [u8],
    limits: &ExtensionLimits,
    watch: &impl Watch,
) -> Result<Extension, TrackError> {
    watch.go_on(0.0)?;
    let smooth = smoothed(values);
    let enclosure = Enclosure::new(values.grid(), REACH_MM);
    watch.go_on(0.2)?;
    let levels = Levels::of_lung(&smooth, lumen, &enclosure, limits);
    let reached = reach(values, &smooth, &enclosure, lumen, levels, limits, watch)?;
    let ran_out = reached.len() > levels.most_reached;
    let (mut kept, mut followed) = (Vec::new(), Vec::new());
    if !ran_out {
        watch.go_on(0.7)?;
        let view = VolumeView::new(&smooth, values.grid()).map_err(|e| TrackError::Argument {
            what: "volume",
            expected: "a full array".to_owned(),
            found: e.to_string(),
        })?;
        let open = open_from(values, &smooth, lumen, &reached, levels);
        let limits = ExtensionLimits {
            least_probability: limits.least_probability(levels, reached.len()),
            ..*limits
        };
        let mut search = Search::new(values, view, lumen, &reached, &open, levels);
        followed = search.follow(&limits, watch)?;
        kept = search.filled(&smooth, &followed);
    }
    for node in &reached {
        lumen[node.voxel as usize] = 0;
    }
    for voxel in &kept {
        lumen[*voxel as usize] = EXTENDED;
    }
    lumen.par_iter_mut().for_each(|v| {
        if *v > EXTENDED {
            *v = 0;
        }
    });
    Ok(Extension {
        ran_out,
        num_voxels: kept.len(),
        enclosed: f64::from(levels.followed),
        followed: followed
            .into_iter()
            .map(|path| path.report(&reached, levels))
            .collect(),
        num_reached: reached.len(),
    })
}
