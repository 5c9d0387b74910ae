//! Two maps of one place, each in its own world and unit, joined by closures of which half are wrong.

use super::*;

/// What the second map's keyframes are numbered from.
pub(crate) const SECOND: u32 = 1000;

/// How the wrong closures are wrong.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Wrong {
    /// Each says something else, anything.
    Random,
    /// Two at a time say the same: as if a second place looked like the first.
    Pairs,
    /// All say the same.
    Together,
}

/// Two maps with drift, the truth, and closures between them from the first map to the second.
pub(crate) struct TwoMaps {
    /// `common_from_keyframe`; the first map's world is the common one.
    pub truth: BTreeMap<KeyframeId, Sim3>,
    /// `world_from_keyframe`, each map in its own world.
    pub maps: [BTreeMap<KeyframeId, Sim3>; 2],
    /// Edges within each map.
    pub edges: [Vec<Edge>; 2],
    pub closures: Vec<Edge>,
    /// Indices of the wrong ones among the closures.
    pub wrong: Vec<usize>,
}

const KEYFRAMES: u32 = 60;
/// Standard deviations of the edges within a map: translation in keyframe units, radians, logarithm of scale.
const STEP_NOISE: [f64; 3] = [0.005, 0.001, 0.002];
/// The same of the closures.
const CLOSURE_NOISE: [f64; 3] = [0.03, 0.01, 0.02];

impl TwoMaps {
    /// A scene with `count` closures, at most 20, of which `wrong` are wrong, spread evenly among the others.
    pub(crate) fn new(seed: u64, count: u32, wrong: u32, how: Wrong) -> Self {
        let mut noise = Noise::new(seed);
        // The second map's unit is 2.5 of the first's; its cameras go the other way.
        let second_from_common = Sim3::exp(&noise.tangent(20.0, 1.5, 0.0)) * similarity([0.0; 3], 0.0, 0.4);
        let first_path = path(0, |i| i as f64, 1.0);
        let second_path = path(SECOND, |i| 90.0 - i as f64, 2.5);
        let edges = [&first_path, &second_path].map(|truth| map_edges(truth, &mut noise));
        let second_own = second_path.iter().map(|(id, pose)| (*id, second_from_common * *pose)).collect();
        let maps = [(&first_path, &edges[0]), (&second_own, &edges[1])].map(|(start, edges)| {
            let mut nodes = start.clone();
            let fixed = BTreeSet::from([*start.keys().next().unwrap()]);
            optimise(&mut nodes, edges, &fixed, &PoseGraphParams::default()).unwrap();
            nodes
        });
        let truth: BTreeMap<_, _> = first_path.into_iter().chain(second_path).collect();
        let mut scene = Self { truth, maps, edges, closures: Vec::new(), wrong: Vec::new() };
        scene.close(count, wrong, how, &mut noise);
        scene
    }

    fn close(&mut self, count: u32, wrong: u32, how: Wrong, noise: &mut Noise) {
        let mut error = Sim3::identity();
        for k in 0..count {
            // The keyframes of both maps that stand at the same place.
            let (from, to) = (KeyframeId(35 + k), KeyframeId(SECOND + 55 - k));
            let is_wrong = (k + 1) * wrong / count > k * wrong / count;
            let mut common_from_to = self.truth[&to];
            if is_wrong {
                let fresh = match how {
                    Wrong::Random => true,
                    Wrong::Pairs => self.wrong.len().is_multiple_of(2),
                    Wrong::Together => self.wrong.is_empty(),
                };
                if fresh {
                    error = Sim3::exp(&match how {
                        Wrong::Random => noise.tangent(8.0, 1.5, 0.7),
                        Wrong::Pairs | Wrong::Together => noise.tangent(4.0, 0.3, 0.2),
                    });
                }
                common_from_to = error * common_from_to;
                self.wrong.push(k as usize);
            }
            let exact = self.truth[&from].inverse() * common_from_to;
            self.closures.push(noisy(from, to, exact, CLOSURE_NOISE, EdgeKind::Merge, noise));
        }
    }

    pub(crate) fn graphs(&self) -> [MapGraph<'_>; 2] {
        [0, 1].map(|i| MapGraph { nodes: &self.maps[i], edges: &self.edges[i] })
    }

    /// Both maps in the first's world, the second placed by one closure.
    pub(crate) fn placed_by(&self, closure: usize) -> BTreeMap<KeyframeId, Sim3> {
        let Edge { from, to, from_from_to, .. } = &self.closures[closure];
        let first_from_second = self.maps[0][from] * *from_from_to * self.maps[1][to].inverse();
        let second = self.maps[1].iter().map(|(id, pose)| (*id, first_from_second * *pose));
        self.maps[0].clone().into_iter().chain(second).collect()
    }

    /// The edges of both maps, and after them those closures.
    pub(crate) fn all_edges(&self, closures: impl IntoIterator<Item = usize>) -> Vec<Edge> {
        let closures = closures.into_iter().map(|i| self.closures[i].clone());
        self.edges.iter().flatten().cloned().chain(closures).collect()
    }

    pub(crate) fn right(&self) -> Vec<usize> {
        (0..self.closures.len()).filter(|i| !self.wrong.contains(i)).collect()
    }
}

fn similarity(translation: [f64; 3], rotation: f64, scale: f64) -> Sim3 {
    Sim3::new(nalgebra::UnitQuaternion::from_euler_angles(0.0, rotation, 0.0), translation.into(), scale)
}

/// A winding path along x, one unit a keyframe.
fn path(first: u32, x: impl Fn(u32) -> f64, unit: f64) -> BTreeMap<KeyframeId, Sim3> {
    let pose = |i| {
        similarity(
            [x(i), 0.3 * (0.2 * x(i)).cos(), 4.0 * (0.07 * x(i)).sin()],
            0.2 * (0.1 * x(i)).sin(),
            unit,
        )
    };
    (0..KEYFRAMES).map(|i| (KeyframeId(first + i), pose(i))).collect()
}

fn noisy(
    from: KeyframeId,
    to: KeyframeId,
    exact: Sim3,
    sigma: [f64; 3],
    kind: EdgeKind,
    noise: &mut Noise,
) -> Edge {
    let [t, r, s] = sigma;
    // Uniform numbers in −1…1 have the variance 1/3.
    let error = noise.tangent(t, r, s) * 3f64.sqrt();
    let inverse = [t, t, t, r, r, r, s].map(|sigma| 1.0 / (sigma * sigma));
    Edge {
        from,
        to,
        from_from_to: Sim3::exp(&error) * exact,
        information: SMatrix::from_diagonal(&SVector::from(inverse)),
        kind,
    }
}

/// Noisy edges between keyframes one, two and three apart.
fn map_edges(truth: &BTreeMap<KeyframeId, Sim3>, noise: &mut Noise) -> Vec<Edge> {
    let first = truth.keys().next().unwrap().0;
    let mut edges = Vec::new();
    for i in 0..KEYFRAMES {
        for ahead in (1..4).filter(|ahead| i + ahead < KEYFRAMES) {
            let (from, to) = (KeyframeId(first + i), KeyframeId(first + i + ahead));
            let kind = if ahead == 1 { EdgeKind::Odometry } else { EdgeKind::Covisibility };
            edges.push(noisy(from, to, truth[&from].inverse() * truth[&to], STEP_NOISE, kind, noise));
        }
    }
    edges
}
