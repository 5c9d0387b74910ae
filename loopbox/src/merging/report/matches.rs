//! Key-point matches, side by side.

use crate::merging::Input;
use geometry::Pinhole;
use map::{Keyframe, KeyframeId};
use merge::closure::PairOutcome;
use merge::pair::Pair;
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;
use view::report::cloud::evenly;
use view::report::gallery::{Shrunk, shrunk_jpeg};
use view::report::pack::Packed;

/// Most pictures on a page; pairs after them come without.
const MAX_PICTURES: usize = 48;
/// Most pixels of a picture.
const MAX_PIXELS: usize = 310_000;
/// Most bytes of a picture.
const MAX_BYTES: usize = 80_000;
/// Most matches held of a pair.
const MAX_MATCHES: usize = 400;

/// Images of matched keyframes, each once.
#[derive(Default, Serialize)]
#[serde(transparent)]
pub struct Pictures {
    pictures: Vec<Picture>,
    #[serde(skip)]
    indices: BTreeMap<(usize, KeyframeId), usize>,
}

#[derive(Serialize)]
struct Picture {
    /// Index of the keyframe in the scene; nothing where it is not shown there.
    keyframe: Option<usize>,
    /// Pixels of the keyframe's image that make one here.
    factor: usize,
    width: usize,
    height: usize,
    jpeg: Packed,
}

impl Pictures {
    /// The index of a keyframe's picture; nothing where the page has enough of them or the keyframe has no image.
    ///
    /// # Errors
    /// When the image cannot be encoded.
    pub fn of(
        &mut self,
        input: usize,
        keyframe: &Keyframe,
        in_scene: Option<usize>,
    ) -> anyhow::Result<Option<usize>> {
        let key = (input, keyframe.id);
        if let Some(index) = self.indices.get(&key) {
            return Ok(Some(*index));
        }
        let empty = keyframe.image.width() == 0 || keyframe.image.height() == 0;
        if empty || self.pictures.len() >= MAX_PICTURES {
            return Ok(None);
        }
        let Shrunk { factor, width, height, jpeg } = shrunk_jpeg(keyframe, MAX_PIXELS, MAX_BYTES)?;
        self.pictures.push(Picture { keyframe: in_scene, factor, width, height, jpeg });
        self.indices.insert(key, self.pictures.len() - 1);
        Ok(Some(self.pictures.len() - 1))
    }
}

/// The matches of a pair that agree with its relative pose, from left to right in the source's image.
#[derive(Serialize)]
pub struct Matches {
    /// How many there are: γ.
    count: usize,
    /// How many of them have depth on both sides.
    with_depth: usize,
    /// How many features matched before the relative pose was known.
    candidates: usize,
    /// x, y in the source's image, x, y in the target's, pixels, f32 × 4; a choice where there are many.
    pixels: Packed,
    /// 1 where depth is known on both sides, u8 each.
    depth: Packed,
}

impl Matches {
    /// The matches of a measured pair of the inputs `source` and `target`; nothing where the pair was not measured.
    pub fn new(source: &Input, target: &Input, outcome: &PairOutcome) -> Option<Self> {
        let pair = outcome.measured.as_ref().ok()?;
        let (from, to) = (source.features.get(pair.views.source)?, target.features.get(pair.views.target)?);
        let camera = |input: &Input, id| Some(*input.map.camera(input.map.keyframes.get(id)?));
        let cameras = [camera(source, &pair.views.source)?, camera(target, &pair.views.target)?];
        let inliers: Vec<[f32; 4]> = pair
            .views
            .relative_pose
            .inliers
            .iter()
            .filter_map(|index| {
                let found = pair.views.matches.get(*index)?;
                let [x, y] = from.keypoints.get(found.source as usize)?.pixel;
                let [u, v] = to.keypoints.get(found.target as usize)?.pixel;
                Some([x, y, u, v])
            })
            .collect();
        let depth = with_depth(&inliers, pair, cameras);
        let mut matches: Vec<([f32; 4], bool)> = inliers.into_iter().zip(depth).collect();
        matches.sort_by(|(a, _), (b, _)| a[0].total_cmp(&b[0]));
        let (count, with_depth) = (matches.len(), matches.iter().filter(|(_, depth)| *depth).count());
        evenly(&mut matches, MAX_MATCHES);
        Some(Self {
            count,
            with_depth,
            candidates: pair.views.matches.len(),
            pixels: Packed::f32(matches.iter().flat_map(|(pixels, _)| *pixels)),
            depth: Packed(matches.iter().map(|(_, depth)| u8::from(*depth)).collect()),
        })
    }
}

/// Which of the inliers became 3-D points: both are in one order, and a point lies on its key point's ray.
fn with_depth(inliers: &[[f32; 4]], pair: &Pair, [source, target]: [Pinhole; 2]) -> Vec<bool> {
    let mut points = pair.points.iter().peekable();
    let on_ray = |camera: &Pinhole, x: f32, y: f32, point: &Vector3<f64>| {
        let ray = camera.unproject(f64::from(x), f64::from(y));
        (ray * point.z - point).norm() <= 1e-9 * point.norm()
    };
    inliers
        .iter()
        .map(|[x, y, u, v]| {
            points
                .next_if(|point| {
                    on_ray(&source, *x, *y, &point.source.position)
                        && on_ray(&target, *u, *v, &point.target.position)
                })
                .is_some()
        })
        .collect()
}
