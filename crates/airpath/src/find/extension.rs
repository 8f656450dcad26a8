//! Second step of the search: paths from the lumen of the flood into smaller airways that the flood missed
//! (docs/algorithms.md).
//!
//! The flood ends where the wall of an airway is not brighter everywhere than the level of the flood. The extension
//! searches by shape instead of by level: from the lumen's surface it follows, face to face, voxels that are enclosed
//! by brighter wall ([`crate::find::tubeness`]). The threshold of the enclosure comes from the volume itself: lung away
//! from the airways shows the enclosures that noise, texture and vessels cause. At most a fiftieth of the lung passes
//! the threshold, far below the share (31 % of a cubic lattice joined by faces) at which randomly placed voxels would
//! form connected paths of any length. An edge-enhancing kernel arranges such voxels in sheets (docs/decisions/0113),
//! so a search that reaches too much of the lung is cancelled.
//!
//! The reached voxels give paths from the lumen, along the most enclosed voxels, to the farthest tips, the longest path
//! first. A path ends where its further course does not look like an airway. A path that is short, or not clearly
//! better than lung, is discarded. Round an accepted path the lumen consists of the voxels that are darker than
//! half-way up to the wall at that part of the path.

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::find::extension_levels::Levels;
pub use crate::find::extension_levels::{Divided, EXTENDED, ExtensionLimits, Followed};
use crate::find::extension_reach::{open_from, reach};
use crate::find::extension_ways::Search;
use crate::find::tubeness::{Enclosure, REACH_MM, smoothed};
use carina_leastcost::{TrackError, Watch};

/// Paths and voxels that [`extend`] added to the lumen of the flood.
#[derive(Debug, Clone, PartialEq)]
pub struct Extension {
    /// Accepted paths along small airways; each path comes before the paths that branch off it.
    pub followed: Vec<Followed>,
    /// Number of voxels that the extension added to the lumen.
    pub num_voxels: usize,
    /// Threshold of the enclosure (rise in value to the walls round a voxel), which 98 % of the lung does not reach.
    pub enclosed: f64,
    /// Number of voxels that were reached from the lumen's surface, in accepted and in rejected paths.
    pub num_reached: usize,
    /// Whether the search was cancelled because it reached more of the lung than airways occupy; then it added nothing.
    pub ran_out: bool,
}

/// Add small airways to `lumen` (1 inside, 0 outside; face-connected) in place; each added voxel gets the value
/// [`EXTENDED`].
///
/// # Errors
///
/// Returns an error if `watch` stops the search.
pub fn extend(
    values: VolumeView<'_, i16>,
    lumen: &mut [u8],
    limits: &ExtensionLimits,
    watch: &impl Watch,
) -> Result<Extension, TrackError> {
    watch.report_fraction(0.0)?;
    let smooth = smoothed(values);
    let enclosure = Enclosure::new(values.grid(), REACH_MM);
    watch.report_fraction(0.2)?;
    let levels = Levels::of_lung(&smooth, lumen, &enclosure, limits);
    let reached = reach(values, &smooth, &enclosure, lumen, levels, limits, watch)?;
    let ran_out = reached.len() > levels.most_reached;
    let (mut added, mut followed) = (Vec::new(), Vec::new());
    if !ran_out {
        watch.report_fraction(0.7)?;
        let view = VolumeView::new(&smooth, values.grid()).map_err(|e| TrackError::Argument {
            what: "volume",
            expected: "a full array".to_owned(),
            found: e.to_string(),
        })?;
        let open = open_from(values, &smooth, lumen, &reached, levels);
        let mut search = Search::new(values, view, lumen, &reached, &open, levels);
        followed = search.follow(limits, watch)?;
        added = search.filled(&smooth, &followed);
    }
    for node in &reached {
        lumen[node.voxel as usize] = 0;
    }
    for voxel in &added {
        lumen[*voxel as usize] = EXTENDED;
    }
    lumen.par_iter_mut().for_each(|v| {
        if *v > EXTENDED {
            *v = 0;
        }
    });
    Ok(Extension {
        ran_out,
        num_voxels: added.len(),
        enclosed: f64::from(levels.followed),
        followed: followed
            .into_iter()
            .map(|path| path.report(&reached, levels))
            .collect(),
        num_reached: reached.len(),
    })
}
