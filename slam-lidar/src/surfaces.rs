//! The local map: Gaussians of points in voxels of three sizes, the flat ones among them as planes.
//!
//! A point is compared with the largest flat voxel that holds it. Large voxels have seen the most points and are not
//! misled by the pattern of rings; where the world is not flat at their size, smaller ones are asked. Voxels in which
//! nothing is flat at any size give their mean, of which little is asked (see `registration`).
//!
//! Where a sensor begins, each ring leaves one line on the floor. A plane through the strip that few sweeps make of it
//! has the slope that the poses happened to have, and the next sweeps, which lie beside it, carry that slope on: maps began
//! tilted by degrees. So a plane must span most of its voxel, and until one does, points are compared with planes of longer
//! voxels, in which several rings lie.

use crate::voxels::{VoxelKey, VoxelTable, cell_at, cell_of, key_of};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use serde::{Deserialize, Serialize};

/// How the local map is built.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceParams {
    /// Edge of the smallest voxels, metres, > 0; the others are twice and four times as large. Smaller sees finer
    /// structure and needs more points.
    pub voxel: f32,
    /// Thickness (standard deviation) up to which the points of a voxel are a plane, metres. About twice the noise of
    /// ranges: that of common sensors is 1–3 cm.
    pub thickness: f32,
    /// Fewest points of a plane, ≥ 4.
    pub least_points: u32,
    /// A plane must extend so many times its thickness in its narrower direction: points of a single ring do not.
    pub aspect: f32,
    /// A plane extends so many times the shortest edge of its voxel in its narrower direction, standard deviation: 0.29 fills it
    /// evenly, 0.2 does so over seven tenths.
    pub width: f32,
    /// Whether points that no voxel's plane holds are compared with planes of longer voxels: what a sensor sees first.
    pub long: bool,
    /// Points after which a voxel learns no more: what was mapped first drifted least.
    pub most_points: u32,
}

impl Default for SurfaceParams {
    fn default() -> Self {
        Self {
            voxel: 0.25,
            thickness: 0.04,
            least_points: 6,
            aspect: 3.0,
            width: 0.2,
            long: false,
            most_points: 400,
        }
    }
}

/// What a voxel tells of its surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surface {
    /// Mean of the points, metres.
    pub mean: [f32; 3],
    /// Unit axes of the points' scatter, the narrowest first: the normal of a plane.
    pub axes: [[f32; 3]; 3],
    /// Variance of the points along each axis, with that of the fit, square metres. 0: nothing is asked along it.
    pub variances: [f32; 3],
    /// Of a line or a scatter, axes along which the voxel cuts the points off: they end where the voxel does, not where something in the
    /// world does, and say nothing about how far a point has moved.
    pub cut: [bool; 3],
    /// Of a plane, variance of the slope by which its normal leans towards the second and the third axis by chance: of the points' noise
    /// over their spread and count. 0 of others.
    pub slopes: [f32; 2],
}

impl Surface {
    /// How many axes ask something of a point: 1 for a plane, 2 for a line, 3 for a scatter, 0 where nothing is known.
    pub fn constraints(&self) -> usize {
        self.variances.iter().filter(|v| **v > 0.0).count()
    }
}

/// Sums over the points of a voxel, relative to its centre.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f32,
    first: [f32; 3],
    second: [f32; 6],
}

/// Voxels of one size.
#[derive(Clone, Debug)]
struct Level {
    /// Edges, metres, and one over them.
    edges: [f32; 3],
    inverse: [f32; 3],
    table: VoxelTable,
    keys: Vec<VoxelKey>,
    sums: Vec<Sums>,
    surfaces: Vec<Surface>,
    /// Points at the last fit.
    fitted: Vec<f32>,
    changed: Vec<u32>,
}

/// Sizes of voxels, each twice the one before.
pub const LEVELS: usize = 3;
/// Edges of longer voxels, in the smallest ones': three of the largest in a row, as a floor between walls, and cubes.
const LONG: [[f32; 3]; 5] = [[12.0, 4.0, 4.0], [4.0, 12.0, 4.0], [4.0, 4.0, 12.0], [8.0; 3], [16.0; 3]];
/// A surface is fitted again once its voxel holds so many times as many points.
const REFIT: f32 = 1.25;
/// Least standard deviation that a plane is believed to have, metres: below it calibration, not noise, decides.
const LEAST_DEVIATION: f32 = 0.01;

impl Level {
    fn new(edges: [f32; 3]) -> Self {
        Self {
            edges,
            inverse: edges.map(|edge| 1.0 / edge),
            table: VoxelTable::default(),
            keys: vec![],
            sums: vec![],
            surfaces: vec![],
            fitted: vec![],
            changed: vec![],
        }
    }

    fn cell(&self, point: [f32; 3]) -> [i32; 3] {
        cell_at([0, 1, 2].map(|i| point[i] * self.inverse[i]), 1.0)
    }

    /// What the voxel of a point tells; none where it is empty.
    #[inline]
    fn surface_at(&self, point: [f32; 3]) -> Option<&Surface> {
        self.table.get(key_of(self.cell(point))).map(|index| &self.surfaces[index as usize])
    }

    /// Adds a point; returns its voxel.
    fn insert(&mut self, point: [f32; 3], most: f32) -> usize {
        let cell = self.cell(point);
        let (index, new) = self.table.get_or_insert(key_of(cell));
        let index = index as usize;
        if new {
            self.keys.push(key_of(cell));
            self.sums.push(Sums::default());
            self.surfaces.push(Surface::default());
            self.fitted.push(0.0);
        }
        let sums = &mut self.sums[index];
        if sums.count >= most {
            return index;
        }
        let [x, y, z] = [0, 1, 2].map(|i| point[i] - (cell[i] as f32 + 0.5) * self.edges[i]);
        let was_due = sums.count >= REFIT * self.fitted[index];
        sums.count += 1.0;
        sums.first = [sums.first[0] + x, sums.first[1] + y, sums.first[2] + z];
        let squares = [x * x, x * y, x * z, y * y, y * z, z * z];
        sums.second.iter_mut().zip(squares).for_each(|(sum, v)| *sum += v);
        if !was_due && sums.count >= REFIT * self.fitted[index] || new {
            self.changed.push(index as u32);
        }
        index
    }

    fn refit(&mut self, smallest: bool, params: &SurfaceParams) {
        for index in std::mem::take(&mut self.changed) {
            let i = index as usize;
            self.surfaces[i] = fit(&self.sums[i], self.keys[i], self.edges, smallest, params);
            self.fitted[i] = self.sums[i].count;
        }
    }

    /// Keeps the voxels for which `keep` holds, in their order.
    fn retain(&mut self, keep: impl Fn([f32; 3]) -> bool) {
        let centre = |key: VoxelKey| {
            let cell = cell_of(key);
            [0, 1, 2].map(|i| (cell[i] as f32 + 0.5) * self.edges[i])
        };
        let kept: Vec<usize> = (0..self.keys.len()).filter(|&i| keep(centre(self.keys[i]))).collect();
        self.keys = kept.iter().map(|&i| self.keys[i]).collect();
        self.sums = kept.iter().map(|&i| self.sums[i]).collect();
        self.surfaces = kept.iter().map(|&i| self.surfaces[i]).collect();
        self.fitted = kept.iter().map(|&i| self.fitted[i]).collect();
        self.table = VoxelTable::default();
        self.keys.iter().for_each(|&key| _ = self.table.get_or_insert(key));
    }
}

/// The covariance's eigenvalues ascending, with their vectors as columns.
pub(crate) fn sorted_eigen(covariance: Matrix3<f64>) -> ([f64; 3], Matrix3<f64>) {
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let vectors = Matrix3::from_columns(&order.map(|i| eigen.eigenvectors.column(i).into_owned()));
    (order.map(|i| eigen.eigenvalues[i].max(0.0)), vectors)
}

/// Fits what a voxel's points are: a plane, on the smallest level also a line or a scatter, or nothing.
fn fit(sums: &Sums, key: VoxelKey, edges: [f32; 3], smallest: bool, params: &SurfaceParams) -> Surface {
    let n = f64::from(sums.count);
    let mean = Vector3::from(sums.first.map(|v| f64::from(v) / n));
    let cell = cell_of(key);
    let size = edges[0].min(edges[1]).min(edges[2]);
    let world = |i: usize| mean[i] as f32 + (cell[i] as f32 + 0.5) * edges[i];
    let mut surface = Surface { mean: [world(0), world(1), world(2)], ..Surface::default() };
    if sums.count < params.least_points as f32 {
        return surface;
    }
    let s = sums.second.map(|v| f64::from(v) / n);
    let covariance =
        Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]) - mean * mean.transpose();
    let (values, vectors) = sorted_eigen(covariance);
    surface.axes = [0, 1, 2].map(|k| [0, 1, 2].map(|i| vectors[(i, k)] as f32));
    let deviations = values.map(|v| v.sqrt() as f32);
    // Parameters are fitted to the points: a plane takes three.
    let doubt = 1.0 + 3.0 / sums.count;
    let variance = |deviation: f32| deviation.max(LEAST_DEVIATION).powi(2) * doubt;
    let thin = |k: usize| deviations[k] <= params.thickness;
    if thin(0)
        && deviations[1] >= (params.aspect * deviations[0].max(LEAST_DEVIATION)).max(params.width * size)
    {
        surface.variances[0] = variance(deviations[0]);
        let independent = sums.count.min(INDEPENDENT);
        surface.slopes = [1, 2].map(|k| surface.variances[0] / (independent * values[k] as f32));
        return surface;
    }
    // Evenly spread points reach √3 standard deviations from their mean.
    surface.cut = [0, 1, 2].map(|k| {
        let reach = |i: usize| mean[i].abs() + CUT * (values[k].sqrt() * vectors[(i, k)]).abs();
        (0..3).any(|i| reach(i) > 0.5 * f64::from(edges[i]))
    });
    if smallest && !thin(0) {
        surface.variances = deviations.map(variance);
    } else if smallest
        && thin(1)
        && surface.axes[2][2].abs() > UPRIGHT
        && deviations[2] >= params.width * size
    {
        surface.variances = [variance(deviations[0]), variance(deviations[1]), 0.0];
    }
    surface
}

/// Points that a voxel cuts off reach its boundary within so many standard deviations.
const CUT: f64 = 2.5;
/// Points of a plane count as so many that err independently at most: those of a sweep err with its pose. By the true normals of ray-cast
/// halls, tunnels and corridors slopes vary 0.6–2.9 times as much as by that.
const INDEPENDENT: f32 = 20.0;
/// Sine of the least slope of a line that is believed: flatter ones may be the trace of a ring on something else.
const UPRIGHT: f32 = 0.7;

/// The local map.
#[derive(Clone, Debug)]
pub struct SurfaceMap {
    params: SurfaceParams,
    levels: [Level; LEVELS],
    /// Longer voxels, which hold what came before the largest one of its place was flat.
    long: Vec<Level>,
}

impl SurfaceMap {
    /// An empty map.
    pub fn new(params: SurfaceParams) -> Self {
        let level = |edges: [f32; 3]| Level::new(edges.map(|edge| edge * params.voxel));
        let long = if params.long { LONG.map(level).into() } else { Vec::new() };
        Self { params, levels: [4.0, 2.0, 1.0].map(|scale| level([scale; 3])), long }
    }

    /// Edge of the smallest voxels, metres.
    pub fn voxel(&self) -> f32 {
        self.params.voxel
    }

    /// Whether nothing is mapped.
    pub fn is_empty(&self) -> bool {
        self.levels[0].keys.is_empty()
    }

    /// Adds points of the world, metres.
    pub fn insert(&mut self, points: impl Iterator<Item = [f32; 3]>) {
        let most = self.params.most_points as f32;
        for point in points {
            let [largest, others @ ..] = &mut self.levels;
            let index = largest.insert(point, most);
            others.iter_mut().for_each(|level| _ = level.insert(point, most));
            if largest.surfaces[index].constraints() == 0 {
                self.long.iter_mut().for_each(|level| _ = level.insert(point, most));
            }
        }
        for (i, level) in self.levels.iter_mut().enumerate() {
            level.refit(i + 1 == LEVELS, &self.params);
        }
        self.long.iter_mut().for_each(|level| level.refit(false, &self.params));
    }

    /// The surface that holds a point: that of its largest flat voxel, or what its smallest one holds, or the plane of a
    /// longer one.
    #[inline]
    pub fn surface_at(&self, point: [f32; 3]) -> Option<&Surface> {
        for level in &self.levels {
            // Where a large voxel is empty its parts are.
            let surface = level.surface_at(point)?;
            if surface.variances[0] > 0.0 {
                return Some(surface);
            }
        }
        self.long.iter().filter_map(|level| level.surface_at(point)).find(|s| s.variances[0] > 0.0)
    }

    /// Forgets all that lies farther than `radius` metres from `centre`.
    pub fn keep_near(&mut self, centre: [f32; 3], radius: f32) {
        for level in self.levels.iter_mut().chain(&mut self.long) {
            level.retain(|p| (0..3).map(|i| (p[i] - centre[i]).powi(2)).sum::<f32>() <= radius * radius);
        }
    }

    /// Number of voxels of all sizes.
    pub fn len(&self) -> usize {
        self.levels.iter().chain(&self.long).map(|level| level.keys.len()).sum()
    }
}
