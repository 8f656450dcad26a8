use carina_grid::{Affine, Grid, length};

use crate::PhantomError;
use crate::airway_tube::{AirwayTube, TubeKind, TubeTruth};
use crate::airways::AirwayTree;
use crate::body::{Body, chest_skin, lung_distance};
use crate::lobectomy::Lobe;
use crate::neck::{NECK_TOP_Z, Neck};
use crate::nodule::Nodule;
use crate::random::Random;
use crate::shapes::{along, normals, sub, tilted};
use crate::variants::Variants;
use crate::vessels::vessels;
use crate::voxels::Scene;

/// Lower corner of the chest's box, LPS mm with the carina at the origin.
///
/// The top of the box is at the first point of the ground truth.
const LO_LPS: [f64; 3] = [-172.0, -126.0, -200.0];
/// Upper corner of the chest's box, LPS mm with the carina at the origin.
const HI_LPS: [f64; 3] = [172.0, 122.0, TOP_Z];
/// Height z of the top of a chest's box without a neck, LPS mm.
const TOP_Z: f64 = 110.0;

/// Options with which a phantom chest is generated.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "independent switches, each named where it is set"
)]
pub struct ChestOptions {
    /// Seed of the random choices; the same seed gives the same chest.
    pub seed: u64,
    /// Distance between voxel centres along x, y, z, mm.
    pub spacing_mm: [f64; 3],
    /// Generation below which airways divide (trachea 0), 3 to 9.
    pub generations: usize,
    /// Whether one central bronchus of the chest is narrowed.
    pub stenosis: bool,
    /// Whether the chest contains a nodule near a peripheral airway.
    pub nodule: bool,
    /// Standard deviation of the noise, 0 to 200 HU.
    pub noise_hu: f64,
    /// Whether the volume continues above the chest: larynx, throat and the surrounding neck.
    ///
    /// The trachea then ends at the cricoid.
    pub neck: bool,
    /// Kind of the tube in the trachea; a tracheostomy requires the neck; `None` for no tube.
    pub tube: Option<TubeKind>,
    /// Lobe that was resected, whose bronchus ends in a stump; `None` for a complete lung.
    pub resected: Option<Lobe>,
    /// Anatomical variants of the airways; not together with a tube or a resected lobe.
    pub variants: Variants,
    /// Part of the chest to be computed, `[lo, hi]` in LPS mm; `None` for all. The ground truth is that of the whole
    /// chest.
    pub box_lps: Option<[[f64; 3]; 2]>,
    /// Whether the signed distance to the lumen is also returned.
    pub with_distance: bool,
}

impl Default for ChestOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            spacing_mm: [0.8; 3],
            generations: 6,
            stenosis: false,
            nodule: false,
            noise_hu: 20.0,
            neck: false,
            tube: None,
            resected: None,
            variants: Variants::default(),
            box_lps: None,
            with_distance: false,
        }
    }
}

/// Stenosis: narrowing of one airway of the phantom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stenosis {
    /// ID of the narrowed airway.
    pub branch_id: usize,
    /// Point of the centreline at the narrowest position, LPS mm.
    pub centre_lps: [f64; 3],
    /// Length of the narrowed part, mm.
    pub length_mm: f64,
    /// Radius of the lumen at the narrowest position, mm.
    pub min_radius_mm: f64,
    /// Radius of the lumen at the same position without the narrowing, mm.
    pub reference_radius_mm: f64,
}

/// Phantom chest CT with its ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Chest {
    /// Grid of the chest's voxels.
    pub grid: Grid,
    /// CT values of the voxels in HU, x fastest.
    pub hu: Vec<i16>,
    /// Mask of the lumen: 1 for a voxel whose centre is inside an airway's lumen.
    pub lumen: Vec<u8>,
    /// Mask of the air above the cricoid (larynx, throat): 1 for a voxel whose centre is inside; `None` without a neck.
    pub upper_airway: Option<Vec<u8>>,
    /// Signed distance to the lumen's surface in mm, negative inside, exact including the fillets at the carinas.
    ///
    /// The value is 5 or more where no airway is near. The field is `None` unless requested.
    pub lumen_distance_mm: Option<Vec<f32>>,
    /// Airways of the chest: the ground truth for a search.
    pub tree: AirwayTree,
    /// Ground truth of the nodule; `None` without a nodule.
    pub nodule: Option<Nodule>,
    /// Ground truth of the stenosis; `None` without a stenosis.
    pub stenosis: Option<Stenosis>,
    /// Middle of the airway at the lower border of the cricoid, LPS mm; `None` without a neck.
    pub cricoid_lps: Option<[f64; 3]>,
    /// Ground truth of the tube in the trachea; `None` without a tube.
    pub tube: Option<TubeTruth>,
}

impl ChestOptions {
    /// Return the grid on which a chest with these options is generated.
    ///
    /// # Errors
    ///
    /// Returns an error if an option is out of range.
    pub fn grid(&self) -> Result<Grid, PhantomError> {
        let refuse = |what, expected, found| {
            Err(PhantomError::Option {
                what,
                expected,
                found,
            })
        };
        if self.spacing_mm.iter().any(|s| !(0.3..=10.0).contains(s)) {
            let found = format!("{:?}", self.spacing_mm);
            return refuse("voxel spacing", "0.3 to 10 mm on each axis", found);
        }
        if !(3..=9).contains(&self.generations) {
            return refuse("generations", "3 to 9", self.generations.to_string());
        }
        if !(0.0..=200.0).contains(&self.noise_hu) {
            return refuse("noise", "0 to 200 HU", self.noise_hu.to_string());
        }
        if self.tube == Some(TubeKind::Tracheostomy) && !self.neck {
            return refuse("tracheostomy", "a chest with its neck", "none".to_owned());
        }
        if self.variants != Variants::default() && (self.tube.is_some() || self.resected.is_some())
        {
            let found = "both".to_owned();
            return refuse(
                "variant",
                "a chest without a tube and a resected lobe",
                found,
            );
        }
        if self.variants.conflict() {
            let found = self.variants.names().join(", ");
            return refuse("variant", "left isomerism alone", found);
        }
        let top = if self.neck { NECK_TOP_Z } else { TOP_Z };
        let whole = [LO_LPS, [HI_LPS[0], HI_LPS[1], top]];
        let [lo, hi] = self.box_lps.unwrap_or(whole);
        if (0..3).any(|a| !(hi[a] - lo[a] >= 2.0 * self.spacing_mm[a] && hi[a] - lo[a] < 2000.0)) {
            let found = format!("{lo:?} to {hi:?}");
            return refuse("box", "two voxels to 2 m on each axis", found);
        }
        let num: [usize; 3] =
            std::array::from_fn(|a| ((hi[a] - lo[a]) / self.spacing_mm[a]).floor() as usize + 1);
        let origin = [
            0.5 * (lo[0] + hi[0] - (num[0] - 1) as f64 * self.spacing_mm[0]),
            0.5 * (lo[1] + hi[1] - (num[1] - 1) as f64 * self.spacing_mm[1]),
            // The top slice is at the top of the box, so that the trachea begins in it for any spacing.
            hi[2] - (num[2] - 1) as f64 * self.spacing_mm[2],
        ];
        let [sx, sy, sz] = self.spacing_mm;
        let lps_from_ijk =
            Affine::from_columns([sx, 0.0, 0.0], [0.0, sy, 0.0], [0.0, 0.0, sz], origin);
        Ok(Grid::new([num[2], num[1], num[0]], lps_from_ijk)?)
    }

    fn body_and_tree(&self) -> (Body, AirwayTree) {
        let body = Body::new(self.seed);
        let top_z = if self.neck {
            Neck::trachea_top_z(self.seed)
        } else {
            TOP_Z
        };
        let mut tree = AirwayTree::grow(self.seed, self.generations, top_z, self.variants);
        if let Some(lobe) = self.resected {
            tree.resect(lobe);
        }
        if !self.neck {
            return (body, tree);
        }
        let trachea = &tree.branches[0];
        let neck = Neck::new(self.seed, trachea.points[0], trachea.radius_mm[0]);
        (body.with_neck(neck), tree)
    }
}

impl Chest {
    /// Generate a chest on the grid of its options.
    ///
    /// `proceed` is called repeatedly with the completed fraction of the work (0 to 1); if it returns `false`, the
    /// function ends with [`PhantomError::Cancelled`].
    ///
    /// # Errors
    ///
    /// Returns an error if an option is out of range or `proceed` returns `false`.
    pub fn generate(
        options: &ChestOptions,
        proceed: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, PhantomError> {
        let grid = options.grid()?;
        Self::generate_on(&grid, options, proceed)
    }

    /// Return the signed distances in mm from points (LPS mm) to the lumen of a chest, negative inside.
    ///
    /// Near the surface the value is the exact distance; deep inside it is a lower bound of the depth, and 5 where no
    /// airway is near.
    ///
    /// # Errors
    ///
    /// Returns an error if an option is out of range.
    pub fn lumen_distances_at(
        options: &ChestOptions,
        points: &[[f64; 3]],
    ) -> Result<Vec<f64>, PhantomError> {
        let grid = options.grid()?;
        let (body, mut tree) = options.body_and_tree();
        if options.stenosis {
            narrow(&mut tree, &mut Random::new(options.seed, 5));
        }
        Ok(Scene::new(&tree, &body, &[], None).distances_at(&grid, points))
    }

    /// Generate a chest on any grid, which may be oblique; `proceed` is as for [`Self::generate`].
    ///
    /// # Errors
    ///
    /// Returns an error if an option is out of range or `proceed` returns `false`.
    pub fn generate_on(
        grid: &Grid,
        options: &ChestOptions,
        proceed: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, PhantomError> {
        options.grid()?;
        let (body, mut tree) = options.body_and_tree();
        let stenosis = options
            .stenosis
            .then(|| narrow(&mut tree, &mut Random::new(options.seed, 5)));
        let nodule = options
            .nodule
            .then(|| place_nodule(&tree, &mut Random::new(options.seed, 6)));
        let vessels = vessels(options.seed, &tree);
        if !proceed(0.0) {
            return Err(PhantomError::Cancelled);
        }
        let tube = options
            .tube
            .map(|kind| AirwayTube::new(kind, options.seed, &tree, body.neck.as_ref(), chest_skin));
        let scene = Scene::new(&tree, &body, &vessels, nodule).with_tube(tube.as_ref());
        let voxels = scene
            .voxelize(
                grid,
                (options.seed ^ 0x51, options.noise_hu),
                options.with_distance,
                proceed,
            )
            .ok_or(PhantomError::Cancelled)?;
        Ok(Self {
            grid: grid.clone(),
            hu: voxels.hu,
            lumen: voxels.lumen,
            upper_airway: options.neck.then_some(voxels.upper),
            lumen_distance_mm: voxels.distance,
            tree,
            nodule,
            stenosis,
            cricoid_lps: body.neck.as_ref().map(|neck| neck.cricoid_lps),
            tube: tube.map(|tube| tube.truth),
        })
    }
}

/// Narrow the left main or the intermediate bronchus to less than half its diameter, and return the ground truth of it.
fn narrow(tree: &mut AirwayTree, random: &mut Random) -> Stenosis {
    let name = if random.unit() < 0.5 { "LMB" } else { "BI" };
    // Without an intermediate bronchus, in a left isomerism, the right main bronchus is narrowed.
    let found = tree.named(name).or_else(|| tree.named("RMB"));
    let id = found.map_or(0, |b| b.id);
    let left = random.range(0.38, 0.48);
    let branch = &mut tree.branches[id];
    let mut cumulative = vec![0.0];
    for w in branch.points.windows(2) {
        cumulative.push(cumulative[cumulative.len() - 1] + length(sub(w[1], w[0])));
    }
    let whole = cumulative[cumulative.len() - 1];
    let length_mm = 14.0f64.min(0.7 * whole);
    // The narrowest position is a point of the centreline, so that the ground truth contains its exact radius.
    let middle = cumulative
        .iter()
        .position(|&s| s >= 0.55 * whole)
        .unwrap_or(0);
    let reference_radius_mm = branch.radius_mm[middle];
    for (n, r) in branch.radius_mm.iter_mut().enumerate() {
        let u = ((cumulative[n] - cumulative[middle]) / (0.5 * length_mm)).clamp(-1.0, 1.0);
        // A raised cosine: 1 in the middle, continuous with the healthy wall at both ends.
        let depth = 0.5 * (1.0 + libm::cos(core::f64::consts::PI * u));
        *r *= 1.0 - (1.0 - left) * depth;
    }
    Stenosis {
        branch_id: id,
        centre_lps: branch.points[middle],
        length_mm,
        min_radius_mm: branch.radius_mm[middle],
        reference_radius_mm,
    }
}

/// Return a nodule 5 to 12 mm beyond the end of a peripheral airway, inside the lung and clear of all airways.
fn place_nodule(tree: &AirwayTree, random: &mut Random) -> Nodule {
    let ends: Vec<usize> = tree
        .branches
        .iter()
        .filter(|b| b.children.is_empty())
        .map(|b| b.id)
        .collect();
    let mut best: Option<(f64, Nodule)> = None;
    for _ in 0..400 {
        let end = &tree.branches[ends[(random.unit() * ends.len() as f64) as usize]];
        let radius_mm = random.range(5.0, 10.0);
        let (across, up) = normals(end.tip_direction());
        let dir = tilted(
            end.tip_direction(),
            across,
            up,
            random.range(0.0, core::f64::consts::TAU),
            random.range(0.0, 0.6),
        );
        let centre_lps = along(end.tip(), radius_mm + random.range(3.0, 8.0), dir);
        let (branch_id, distance_mm) = tree.nearest(centre_lps);
        let found = Nodule {
            centre_lps,
            radius_mm,
            branch_id,
            distance_mm,
        };
        let branch = &tree.branches[branch_id];
        let clear = distance_mm - radius_mm - branch.radius_mm[0] - branch.wall_mm;
        let clearance = clear.min(-lung_distance(centre_lps) - radius_mm - 2.0);
        if clearance > 0.0 {
            return found;
        }
        if best.is_none_or(|(most, _)| clearance > most) {
            best = Some((clearance, found));
        }
    }
    // After 400 failed tries, which did not occur over many seeds, the best position is used.
    best.map_or_else(
        || Nodule {
            centre_lps: tree.branches[0].points[0],
            radius_mm: 0.0,
            branch_id: 0,
            distance_mm: 0.0,
        },
        |(_, nodule)| nodule,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> ChestOptions {
        ChestOptions {
            seed: 11,
            spacing_mm: [1.4, 1.6, 2.1],
            nodule: true,
            stenosis: true,
            box_lps: Some([[-50.0, -30.0, -60.0], [50.0, 40.0, 30.0]]),
            with_distance: true,
            ..ChestOptions::default()
        }
    }

    #[test]
    fn a_chest_does_not_depend_on_the_number_of_threads() {
        let on = |threads: usize| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
                .install(|| Chest::generate(&options(), &mut |_| true).unwrap())
        };
        assert!(on(1) == on(4));
    }

    #[test]
    fn the_lumen_has_equal_positions_on_an_oblique_grid() {
        let straight = Chest::generate(&options(), &mut |_| true).unwrap();
        // The grid is rotated by 20 degrees about z and its i axis is mirrored: another grid in the same patient.
        let (s, c) = (libm::sin(0.35), libm::cos(0.35));
        let oblique = Affine::from_columns(
            [-1.3 * c, -1.3 * s, 0.0],
            [-1.5 * s, 1.5 * c, 0.0],
            [0.0, 0.0, 1.9],
            [40.0, -10.0, -50.0],
        );
        let grid = Grid::new([40, 30, 50], oblique).unwrap();
        let turned = Chest::generate_on(&grid, &options(), &mut |_| true).unwrap();
        assert_eq!(straight.tree, turned.tree);
        let (a, b) = (
            straight.lumen_distance_mm.unwrap(),
            turned.lumen_distance_mm.unwrap(),
        );
        let mut compared = 0;
        for (n, &there) in b.iter().enumerate() {
            let p = grid.lps_from_ijk().point(grid.voxel(n).map(|v| v as f64));
            let Some(v) = straight
                .grid
                .voxel_at(straight.grid.to_ijk(carina_grid::Lps(p)))
            else {
                continue;
            };
            let here = a[straight.grid.index(v)];
            if there < 2.0 && here < 2.0 {
                // The nearest voxel's centre is up to 1.5 mm away, half the diagonal; a distance changes by at most
                // that, except at the slope of the stenosis, where the factor is under 1.4.
                assert!((here - there).abs() < 2.1, "{here} {there} at {p:?}");
                compared += 1;
            }
        }
        assert!(compared > 1000, "{compared}");
    }

    #[test]
    fn distances_at_points_are_those_of_the_voxels() {
        let made = Chest::generate(&options(), &mut |_| true).unwrap();
        let points: Vec<[f64; 3]> = (0..made.grid.num_voxels())
            .map(|n| {
                made.grid
                    .lps_from_ijk()
                    .point(made.grid.voxel(n).map(|v| v as f64))
            })
            .collect();
        let found = Chest::lumen_distances_at(&options(), &points).unwrap();
        for (a, b) in found.iter().zip(made.lumen_distance_mm.unwrap()) {
            // Where one grid reports no near airway, the other may still report one.
            assert!(
                (*a as f32 - b).abs() < 1e-6 || (*a > 3.0 && b > 3.0),
                "{a} {b}"
            );
        }
    }

    #[test]
    fn a_false_result_of_proceed_cancels_the_generation() {
        let mut calls = 0;
        let stopped = Chest::generate(&options(), &mut |_| {
            calls += 1;
            calls < 2
        });
        assert_eq!(stopped, Err(PhantomError::Cancelled));
    }
}
