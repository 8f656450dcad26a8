use carina_grid::{cross, length};

use crate::body::lung_distance;
use crate::random::Random;
use crate::shapes::{along, direction, hermite, mix, normals, sub, tilted};
use crate::skeleton::{Basal, Divisions, RightUpper, UPPER_TRACHEA, named_branches};
use crate::variants::{LEFT_BASAL_TRIFURCATION, Variants};

/// Airway of a phantom with its exact centreline and radii.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Index in [`AirwayTree::branches`]; the trachea is 0.
    pub id: usize,
    /// Id of the branch from whose end this branch starts; `None` for the trachea.
    pub parent: Option<usize>,
    /// Ids of the branches that start at the end of this branch.
    pub children: Vec<usize>,
    /// Number of forks between the trachea and this branch; 0 for the trachea.
    pub generation: usize,
    /// Name of the branch; `None` beyond the segments.
    pub name: Option<&'static str>,
    /// Points of the airway's centreline from its start to its end, LPS mm.
    ///
    /// The first point is the parent's last, bit for bit.
    pub points: Vec<[f64; 3]>,
    /// Radius in mm at each point of the circle with the area of the lumen.
    pub radius_mm: Vec<f64>,
    /// Thickness of the airway's wall, mm.
    pub wall_mm: f64,
}

impl Branch {
    /// Return the last point of the centreline.
    pub(crate) fn tip(&self) -> [f64; 3] {
        self.points[self.points.len() - 1]
    }

    pub(crate) fn tip_direction(&self) -> [f64; 3] {
        let n = self.points.len();
        direction(sub(self.points[n - 1], self.points[n - 2]))
    }

    pub(crate) fn tip_radius(&self) -> f64 {
        self.radius_mm[self.radius_mm.len() - 1]
    }

    /// Return the length of the branch's centreline, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.points
            .windows(2)
            .map(|w| length(sub(w[1], w[0])))
            .sum()
    }

    /// Return the centre and radius of a ball that contains the whole branch with its wall.
    fn ball(&self) -> ([f64; 3], f64) {
        let middle = self.points[self.points.len() / 2];
        let reach = self
            .points
            .iter()
            .zip(&self.radius_mm)
            .map(|(&p, r)| length(sub(p, middle)) + r)
            .fold(0.0, f64::max);
        (middle, reach + self.wall_mm)
    }
}

/// Airways of a phantom; parents come before their children.
#[derive(Debug, Clone, PartialEq)]
pub struct AirwayTree {
    /// All branches; the index of a branch is its id.
    pub branches: Vec<Branch>,
}

/// Return the thickness of an airway's wall in mm from the radius of its lumen.
///
/// The thickness is 1.8 mm at the trachea, 0.9 at a segment, 0.6 at generation 6 (docs/algorithms.md, sizes of
/// airways).
fn wall_mm(radius: f64) -> f64 {
    0.4 + 0.15 * radius
}

/// Minimum distance between the walls of branches that do not meet, mm.
const GAP_MM: f64 = 0.8;
/// Minimum distance of subsegments from the pleura, in addition to their own radius and wall, mm.
const PLEURA_MM: f64 = 2.5;

/// Height above the carina at which a tracheal bronchus arises, mm.
const TRACHEAL_BRONCHUS_Z_MM: f64 = 20.0;

impl AirwayTree {
    /// Create a random tree of airways whose trachea starts at height `top_z`.
    ///
    /// Branches of a generation below `generations` divide, so the tree reaches that generation where the lung has
    /// enough space.
    pub(crate) fn grow(seed: u64, generations: usize, top_z: f64, variants: Variants) -> Self {
        let mut random = Random::new(seed, 1);
        let mut tree = Self {
            branches: Vec::new(),
        };
        let size = random.range(0.95, 1.06);
        tree.add_trachea(top_z, 9.2 * size);
        if variants.tracheal_bronchus {
            tree.divide_trachea();
        }
        let upper = match random.unit() {
            u if u < 0.18 => RightUpper::ApicalWithPosterior,
            u if u < 0.27 => RightUpper::PosteriorWithAnterior,
            _ => RightUpper::Trifurcation,
        };
        let mut basal = |share: f64| {
            if random.unit() < share {
                Basal::LateralWithPosterior
            } else {
                Basal::Separate
            }
        };
        let joined = if variants.published {
            1.0 - LEFT_BASAL_TRIFURCATION
        } else {
            0.7
        };
        let mut divisions = Divisions {
            right_upper: upper,
            right_basal: basal(0.3),
            left_basal: basal(joined),
        };
        if variants.trifurcations {
            divisions = Divisions {
                right_upper: RightUpper::Trifurcation,
                right_basal: Basal::Separate,
                left_basal: Basal::Separate,
            };
        }
        for named in named_branches(divisions, variants) {
            // A branch of a bronchus in two parts arises from the last part.
            let parent = tree
                .branches
                .iter()
                .rev()
                .find(|b| b.name == Some(named.parent))
                .map_or(0, |b| b.id);
            debug_assert!(
                named.parent == UPPER_TRACHEA || tree.branches[parent].name == Some(named.parent)
            );
            // A segment of the table ends at its first division, which in a whole lung is further out: the lung is then
            // filled to some 2 cm from the pleura, as on a real CT.
            let reach = if named.is_segment(variants) {
                1.45
            } else {
                1.0
            };
            let length_mm = named.length_mm * reach * size * random.range(0.94, 1.06);
            let radius = 0.5 * named.diameter_mm * size * random.range(0.95, 1.05);
            // The limit is 6 degrees, because larger rotations of two neighbours could bring named branches into
            // contact.
            let dir = random.near(direction(named.dir), 0.105);
            let branch = tree.shoot(parent, dir, length_mm, radius, Some(named.name));
            tree.push(branch);
        }
        tree.subdivide(generations, &mut Random::new(seed, 2));
        tree
    }

    fn push(&mut self, branch: Branch) {
        if let Some(parent) = branch.parent {
            self.branches[parent].children.push(branch.id);
        }
        self.branches.push(branch);
    }

    /// Add the trachea to the tree: from its anterior upper end in the neck to the carina, which is at the origin.
    fn add_trachea(&mut self, top_z: f64, radius: f64) {
        let top = [1.5, -0.2 * top_z, top_z];
        let num = ((top_z / 1.5).ceil() as usize).max(4);
        let points: Vec<[f64; 3]> = (0..=num)
            .map(|i| {
                let t = i as f64 / num as f64;
                hermite(
                    top,
                    [0.0, 0.10 * top_z, -top_z],
                    [0.0; 3],
                    [-2.0, 0.24 * top_z, -top_z],
                    t,
                )
            })
            .collect();
        let radius_mm = (0..=num)
            .map(|i| radius * (1.0 - 0.06 * i as f64 / num as f64))
            .collect();
        self.push(Branch {
            id: 0,
            parent: None,
            children: Vec::new(),
            generation: 0,
            name: Some("Trachea"),
            points,
            radius_mm,
            wall_mm: wall_mm(radius),
        });
    }

    /// Divide the trachea at the origin of a tracheal bronchus; both pieces keep the trachea's name.
    fn divide_trachea(&mut self) {
        let upper = &mut self.branches[0];
        let at = upper
            .points
            .iter()
            .position(|p| p[2] <= TRACHEAL_BRONCHUS_Z_MM)
            .unwrap_or(upper.points.len() / 2);
        let lower = Branch {
            id: 1,
            parent: Some(0),
            children: Vec::new(),
            generation: 1,
            points: upper.points[at..].to_vec(),
            radius_mm: upper.radius_mm[at..].to_vec(),
            ..upper.clone()
        };
        upper.points.truncate(at + 1);
        upper.radius_mm.truncate(at + 1);
        self.push(lower);
    }

    /// Return a new child of `parent` that bends from the parent's direction into `dir`.
    ///
    /// The child is not yet part of the tree.
    fn shoot(
        &self,
        parent: usize,
        dir: [f64; 3],
        length_mm: f64,
        radius: f64,
        name: Option<&'static str>,
    ) -> Branch {
        let from = &self.branches[parent];
        let start = from.tip();
        let end = along(start, length_mm, dir);
        let leave = direction(along(dir, 0.35, from.tip_direction())).map(|v| v * length_mm);
        let arrive = dir.map(|v| v * length_mm);
        let num = ((length_mm / (0.4 * radius).clamp(0.8, 1.5)).ceil() as usize).max(4);
        let mut points: Vec<[f64; 3]> = (0..=num)
            .map(|i| hermite(start, leave, end, arrive, i as f64 / num as f64))
            .collect();
        points[0] = start;
        Branch {
            id: self.branches.len(),
            parent: Some(parent),
            children: Vec::new(),
            generation: from.generation + 1,
            name,
            points,
            radius_mm: (0..=num)
                .map(|i| radius * (1.0 - 0.08 * i as f64 / num as f64))
                .collect(),
            wall_mm: wall_mm(radius),
        }
    }

    /// Divide every end of a generation below `generations` into two branches, breadth first.
    fn subdivide(&mut self, generations: usize, random: &mut Random) {
        let mut next = 0;
        // The plane of a division is perpendicular to that of the previous division; ends of named branches start with
        // a random plane.
        let mut planes: Vec<Option<[f64; 3]>> = vec![None; self.branches.len()];
        while next < self.branches.len() {
            let id = next;
            next += 1;
            if !self.branches[id].children.is_empty() || self.branches[id].generation >= generations
            {
                continue;
            }
            if let Some((pair, plane)) = self.best_division(id, planes[id], random) {
                for mut branch in pair {
                    branch.id = self.branches.len();
                    self.push(branch);
                    planes.push(Some(plane));
                }
            }
        }
    }

    /// Return two children for the end of a branch, and the normal of their plane.
    ///
    /// Of some random pairs, the one with the largest clearance is returned. The result is `None` if the lung has no
    /// space for any pair.
    fn best_division(
        &self,
        id: usize,
        plane: Option<[f64; 3]>,
        random: &mut Random,
    ) -> Option<([Branch; 2], [f64; 3])> {
        let parent = &self.branches[id];
        let dir = parent.tip_direction();
        let (across, up) = normals(dir);
        // The direction that the children's plane contains: the normal of the previous plane.
        let base = plane.map_or_else(
            || random.range(0.0, core::f64::consts::PI),
            |n| libm::atan2(carina_grid::dot(n, up), carina_grid::dot(n, across)),
        );
        let mut best: Option<(f64, [Branch; 2], [f64; 3])> = None;
        for attempt in 0..24 {
            let wide = f64::from(attempt) / 24.0;
            let turn = base + random.range(-0.4 - 1.2 * wide, 0.4 + 1.2 * wide);
            let mut child = |side: f64| {
                // The angles are Horsfield's, 28 to 39 degrees (docs/algorithms.md, sizes of airways).
                let tilt = random.range(0.44, 0.70);
                let radius = parent.tip_radius() * random.range(0.78, 0.90);
                // Weibel's lengths of generations 4 to 8 are 2.8 to 3.3 diameters; the lengths here are longer, to fill
                // the lung.
                let length_mm =
                    2.0 * radius * random.range(3.6, 5.2) * if attempt < 16 { 1.0 } else { 0.75 };
                let to = tilted(dir, across, up, turn + side, tilt);
                self.shoot(id, to, length_mm, radius, None)
            };
            let pair = [child(0.0), child(core::f64::consts::PI)];
            let clearance = pair
                .iter()
                .map(|b| self.clearance(b))
                .fold(f64::INFINITY, f64::min);
            if clearance > 0.0 && best.as_ref().is_none_or(|(most, ..)| clearance > *most) {
                let normal = direction(cross(pair[0].tip_direction(), pair[1].tip_direction()));
                best = Some((clearance, pair, normal));
            }
        }
        best.map(|(_, pair, normal)| (pair, normal))
    }

    /// Return the clearance of a new branch from the pleura and from all unrelated branches, in mm.
    ///
    /// Below 0 the branch does not fit.
    fn clearance(&self, branch: &Branch) -> f64 {
        let mut clearance = f64::INFINITY;
        // The start is on the parent, which may still be in the hilum.
        let from = branch.points.len() / 3;
        for (&p, &r) in branch.points.iter().zip(&branch.radius_mm).skip(from) {
            clearance = clearance.min(-lung_distance(p) - r - branch.wall_mm - PLEURA_MM);
            if clearance <= 0.0 {
                return clearance;
            }
        }
        let (centre, reach) = branch.ball();
        for other in &self.branches {
            if Some(other.id) == branch.parent {
                continue;
            }
            let (other_centre, other_reach) = other.ball();
            if length(sub(centre, other_centre)) > reach + other_reach + GAP_MM + 12.0 {
                continue;
            }
            for (&p, &r) in branch.points.iter().zip(&branch.radius_mm).skip(1) {
                for (&q, &s) in other.points.iter().zip(&other.radius_mm) {
                    let gap = length(sub(p, q)) - r - s - branch.wall_mm - other.wall_mm;
                    clearance = clearance.min(gap - GAP_MM);
                }
            }
        }
        clearance
    }

    /// Return true if a fillet joins two branches, that is, if they are parent and child or children of one parent.
    pub(crate) fn joined(&self, a: usize, b: usize) -> bool {
        let (pa, pb) = (self.branches[a].parent, self.branches[b].parent);
        pa == Some(b) || pb == Some(a) || (pa.is_some() && pa == pb)
    }

    /// Return the position at a fraction (0 to 1) of a branch's points, and the branch's direction at that position.
    pub(crate) fn place(&self, id: usize, share: f64) -> ([f64; 3], [f64; 3]) {
        let points = &self.branches[id].points;
        let at = share * (points.len() - 1) as f64;
        let i = (at as usize).min(points.len() - 2);
        let t = at - i as f64;
        let p = std::array::from_fn(|a| mix(points[i][a], points[i + 1][a], t));
        (p, direction(sub(points[i + 1], points[i])))
    }

    /// Return the branch with a name; `None` if no branch has it.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Branch> {
        self.branches.iter().find(|b| b.name == Some(name))
    }

    /// Return the id of the branch that is nearest to a point, and the distance from its centreline in mm.
    pub(crate) fn nearest(&self, p: [f64; 3]) -> (usize, f64) {
        let mut best = (0, f64::INFINITY);
        for branch in &self.branches {
            for &q in &branch.points {
                let d = length(sub(p, q));
                if d < best.1 {
                    best = (branch.id, d);
                }
            }
        }
        best
    }
}
