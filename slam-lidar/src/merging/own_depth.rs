//! The depth at which a map's own views put each of its surfels.

use super::surfel::Surfel;
use super::surfels::Surfels;
use super::views::View;
use geometry::Se3;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Fewest rays whose median counts as a depth.
const RAYS: usize = 3;
/// Fewest views that must put a surface at one depth: two may agree by chance.
const VIEWS: usize = 3;
/// Their depths differ from the median by so much at most, metres: the thickness up to which a cell is flat.
const ONE_DEPTH: f32 = 0.04;
/// Depths are compared up to this far before and beyond a surface, metres: what ends nearer is hidden.
const NEAR: f32 = 0.3;
/// Cosine of the angle up to which two views look from the same side, 15°: from farther apart they see other faces of what is in a
/// cell.
const SAME_SIDE: f32 = 0.966;
/// Sine of the least angle between a view and a surface, 20°: at a smaller one the view sees what stands out of a wall, such as a
/// door's frame, and from a little farther aside another part of it.
const FACING: f32 = 0.34;

/// The depths at which a view's rays end, seen along a direction.
pub(super) struct Look {
    /// From the sensor to the surface, a unit vector in the frame of the surface's map.
    direction: [f32; 3],
    /// Where the rays end along the surface's normal, metres; positive beyond the surface.
    depths: Vec<f32>,
}

/// What a map's own views say of one of its surfels.
#[derive(Clone, Debug, Default)]
pub struct OwnDepth {
    /// The depth at which all views put it, metres off its plane; none where they disagree.
    pub(super) depth: Option<f32>,
    /// From where the views see it, unit vectors.
    pub(super) directions: Vec<[f32; 3]>,
    /// How far the rays of the odd views end off the depth of the even ones, and the reverse, metres.
    pub(super) halves: [Option<f32>; 2],
}

fn median(mut values: Vec<f32>) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    values.sort_by(f32::total_cmp);
    let half = values.len() / 2;
    Some(if values.len() % 2 == 1 { values[half] } else { 0.5 * (values[half - 1] + values[half]) })
}

/// What a map's views, from these poses, say of a surfel of another map. `moved` is the surfel in the frame of the views; `back`
/// moves their poses into the frame of the surfel's own map.
pub(super) fn looks<'a>(
    [surfel, moved]: [&'a Surfel; 2],
    views: &'a [View],
    poses: &'a [Se3],
    back: &'a Se3,
) -> impl Iterator<Item = Look> + 'a {
    let look = |(view, pose): (&View, &Se3)| {
        let away = Vector3::from(surfel.middle.map(f64::from)) - (*back * *pose).translation;
        let direction = away.normalize().map(|v| v as f32);
        if direction.dot(&Vector3::from(surfel.axes[0])).abs() < FACING {
            return None;
        }
        let mut depths = Vec::new();
        view.each_crossing(moved, NEAR, |beyond| {
            if beyond > -NEAR {
                depths.push(beyond);
            }
        });
        (!depths.is_empty()).then(|| Look { direction: direction.into(), depths })
    };
    views.iter().zip(poses).filter_map(look)
}

/// The depth at which all views put a surface; none where they disagree or are too few.
fn one_depth(looks: &[&Look]) -> Option<f32> {
    let each: Vec<f32> = looks.iter().filter_map(|look| median(look.depths.clone())).collect();
    let depth = median(each.clone()).filter(|_| each.len() >= VIEWS)?;
    each.iter().all(|own| (own - depth).abs() <= ONE_DEPTH).then_some(depth)
}

/// The median depth of the rays of views from the same side as one of `directions`; none of too few.
pub(super) fn depth_along<'a>(looks: impl Iterator<Item = &'a Look>, directions: &[[f32; 3]]) -> Option<f32> {
    let is_same_side = |look: &&Look| {
        let cosine = |own: &[f32; 3]| (0..3).map(|k| own[k] * look.direction[k]).sum::<f32>();
        directions.iter().any(|own| cosine(own) >= SAME_SIDE)
    };
    let depths: Vec<f32> = looks.filter(is_same_side).flat_map(|look| look.depths.iter().copied()).collect();
    median(depths.clone()).filter(|_| depths.len() >= RAYS)
}

/// What a map's own views, from these poses, say of one of its surfels.
fn own_depth(surfel: &Surfel, views: &[View], poses: &[Se3]) -> OwnDepth {
    if !surfel.is_flat {
        return OwnDepth::default();
    }
    let all: Vec<Look> = looks([surfel, surfel], views, poses, &Se3::identity()).collect();
    let directions = |looks: &[&Look]| looks.iter().map(|look| look.direction).collect::<Vec<_>>();
    let every: Vec<&Look> = all.iter().collect();
    let half = |odd: usize| all.iter().skip(odd).step_by(2).collect::<Vec<&Look>>();
    let off = |own: usize| {
        let (own, other) = (half(own), half(1 - own));
        let depth = one_depth(&own)?;
        Some(depth_along(other.into_iter(), &directions(&own))? - depth)
    };
    OwnDepth { depth: one_depth(&every), directions: directions(&every), halves: [off(0), off(1)] }
}

/// What a map's own views say of each of its surfels; `poses` are those of its keyframes.
pub(super) fn own_depths(map: &Surfels, poses: &[Se3]) -> Vec<OwnDepth> {
    map.all.par_iter().map(|surfel| own_depth(surfel, &map.views, poses)).collect()
}
