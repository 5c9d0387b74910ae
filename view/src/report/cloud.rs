//! The cloud of the 3-D view: world points, thinned to a budget and quantised.

use super::pack::Packed;
use geometry::Pinhole;
use geometry::sensor::Shift;
use map::{Keyframe, Map};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;

/// Most points a report holds; ten bytes each before base64, and three more in colour.
pub const MAX_POINTS: usize = 400_000;

/// So many times the points that are held are looked at.
const CHOICE: usize = 2;
/// How bright a point of a scan is, which has no intensity.
const SCANNED: u8 = 160;
/// Most points that a range is found by.
const RANGE_POINTS: usize = 200_000;

/// Relative standard deviations of inverse depth (σ/d) that code 0 and code 255 stand for; logarithmic between.
const SIGMA_RANGE: [f32; 2] = [1e-3, 1.0];

/// A cloud in the order of its keyframes.
#[derive(Serialize)]
pub struct Cloud {
    /// Points held.
    count: usize,
    /// Pixels of the map that have a depth, and points of its scans.
    total: usize,
    /// Corner of the box that the coordinates are quantised in, world.
    box_min: [f32; 3],
    /// Edge lengths of the box.
    box_size: [f32; 3],
    /// `x, y, z, inverse depth` per point, u16 over the box and over `inverse_depth`.
    position: Packed,
    /// `intensity, code of σ/d` per point, u8.
    value: Packed,
    /// Red, green and blue of each point, u8, where any keyframe has colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    color: Option<Packed>,
    /// Range of world inverse depth that the colours span, 1/map unit.
    pub inverse_depth: [f32; 2],
    /// Relative σ of codes 0 and 255.
    sigma: [f32; 2],
    /// Number of points held of each keyframe, u32.
    per_keyframe: Packed,
}

/// A point of the cloud before quantisation.
#[derive(Clone, Copy)]
struct CloudPoint {
    position: Vector3<f32>,
    inverse_depth: f32,
    intensity: u8,
    color: Option<[u8; 3]>,
    sigma_code: u8,
    keyframe: u32,
}

impl Cloud {
    /// The cloud of some `keyframes` of a map, each agent's in a row, thinned to at most `budget` points: all agents
    /// alike.
    pub fn new(map: &Map, keyframes: &[&Keyframe], budget: usize) -> Self {
        let total = keyframes.iter().map(|keyframe| points_of(keyframe)).sum::<usize>();
        let mut points = gather(map, keyframes, (total / (CHOICE * budget).max(1)).max(1));
        let (low, high) = robust_box(&points);
        points.retain(|p| (0..3).all(|i| p.position[i] >= low[i] && p.position[i] <= high[i]));
        let share = budget as f64 / points.len().max(1) as f64;
        let points: Vec<CloudPoint> = points
            .chunk_by(|a, b| keyframes[a.keyframe as usize].agent == keyframes[b.keyframe as usize].agent)
            .flat_map(|own| thinned(own, (own.len() as f64 * share).round() as usize))
            .collect();
        let size = high - low;
        let inverse_depth = range(points.iter().map(|p| p.inverse_depth), 0.02);
        let mut position = Vec::with_capacity(points.len() * 8);
        let mut value = Vec::with_capacity(points.len() * 2);
        let mut per_keyframe = vec![0; keyframes.len()];
        for p in &points {
            let q = (p.position - low).component_div(&size);
            let depth = (p.inverse_depth - inverse_depth[0]) / (inverse_depth[1] - inverse_depth[0]);
            for v in [q.x, q.y, q.z, depth] {
                position.extend(((v.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes());
            }
            value.extend([p.intensity, p.sigma_code]);
            per_keyframe[p.keyframe as usize] += 1;
        }
        let has_color = keyframes.iter().any(|keyframe| keyframe.color.is_some());
        let color = |p: &CloudPoint| p.color.unwrap_or([p.intensity; 3]);
        Self {
            count: points.len(),
            total,
            box_min: low.into(),
            box_size: size.into(),
            position: Packed(position),
            value: Packed(value),
            color: has_color.then(|| Packed(points.iter().flat_map(color).collect())),
            inverse_depth,
            sigma: SIGMA_RANGE,
            per_keyframe: Packed::u32(per_keyframe),
        }
    }
}

/// Pixels of a keyframe that have a depth, or the points of its scan.
pub(super) fn points_of(keyframe: &Keyframe) -> usize {
    keyframe.scan.as_ref().map_or_else(|| keyframe.semi_dense.len(), |scan| scan.len())
}

/// The world points of all keyframes, of each every `step`-th; impossible depths and pixels are passed over.
fn gather(map: &Map, keyframes: &[&Keyframe], step: usize) -> Vec<CloudPoint> {
    let points = |(index, keyframe): (usize, &&Keyframe)| -> Vec<CloudPoint> {
        let points = match map.camera_of(keyframe) {
            Some(camera) => of_image(map, camera, keyframe, index as u32, step),
            None => of_scan(keyframe, index as u32, step),
        };
        keyframe.rest();
        points
    };
    let of_keyframes: Vec<Vec<CloudPoint>> = keyframes.par_iter().enumerate().map(points).collect();
    of_keyframes.concat()
}

/// The points of an image's depths.
fn of_image(map: &Map, camera: &Pinhole, keyframe: &Keyframe, index: u32, step: usize) -> Vec<CloudPoint> {
    let (image, pose) = (&keyframe.image, &keyframe.world_from_keyframe);
    let width = image.width().max(1) as u32;
    let shift = map.image_shift(keyframe).unwrap_or(Shift::none(*camera));
    let turned = pose.rotation.to_rotation_matrix().into_inner() * pose.scale;
    let (depths, colors) = (&keyframe.semi_dense, keyframe.colors());
    let point = |at: usize| {
        let (pixel, inverse_depth, variance) =
            (*depths.pixel.get(at)?, *depths.inverse_depth.get(at)?, *depths.variance.get(at)?);
        let intensity = *image.data().get(pixel as usize)?;
        let (column, row) = (pixel % width, pixel / width);
        let [x, y] = [column, row].map(|place| place as f32);
        let [dx, dy] = shift.to_undistorted([x, y], inverse_depth);
        let ray = camera.unproject(f64::from(x + dx), f64::from(y + dy));
        let world = turned * (ray / f64::from(inverse_depth)) + pose.translation;
        let position = world.cast::<f32>();
        let possible = inverse_depth > 0.0 && inverse_depth.is_finite();
        (possible && position.iter().all(|v| v.is_finite())).then(|| CloudPoint {
            position,
            inverse_depth: inverse_depth / pose.scale as f32,
            intensity,
            color: colors.as_ref().map(|colors| colors.at(column as usize, row as usize, intensity)),
            sigma_code: sigma_code(variance.sqrt() / inverse_depth),
            keyframe: index,
        })
    };
    (0..depths.len()).step_by(step).filter_map(point).collect()
}

/// The points of a scan; their depth is the range.
fn of_scan(keyframe: &Keyframe, index: u32, step: usize) -> Vec<CloudPoint> {
    let pose = &keyframe.world_from_keyframe;
    let turned = pose.rotation.to_rotation_matrix().into_inner() * pose.scale;
    let point = |point: map::CloudPoint| {
        let range = (point.position.norm() * pose.scale) as f32;
        let position = (turned * point.position + pose.translation).cast::<f32>();
        let possible = range > 0.0 && position.iter().all(|v| v.is_finite());
        possible.then(|| CloudPoint {
            position,
            inverse_depth: range.recip(),
            intensity: SCANNED,
            color: None,
            sigma_code: 0,
            keyframe: index,
        })
    };
    keyframe.scan_cloud().step_by(step).filter_map(point).collect()
}

/// The code of a relative standard deviation; unknown (NaN) counts as the worst.
fn sigma_code(sigma: f32) -> u8 {
    let [best, worst] = SIGMA_RANGE;
    let t = (sigma / best).ln() / (worst / best).ln();
    if t.is_nan() { 255 } else { (t.clamp(0.0, 1.0) * 255.0).round() as u8 }
}

/// A box around the bulk of the points with room to spare: a few points gone astray must not cost the
/// others their precision.
fn robust_box(points: &[CloudPoint]) -> (Vector3<f32>, Vector3<f32>) {
    let ranges: [[f32; 2]; 3] = std::array::from_fn(|i| range(points.iter().map(|p| p.position[i]), 0.005));
    let low = Vector3::from_fn(|i, _| ranges[i][0]);
    let high = Vector3::from_fn(|i, _| ranges[i][1]);
    let margin = Vector3::from_element((high - low).max());
    (low - margin, high + margin)
}

/// The `share` and `1 − share` quantiles of some values, never equal; (0, 1) of none.
fn range(values: impl Iterator<Item = f32>, share: f64) -> [f32; 2] {
    let mut values: Vec<f32> = values.collect();
    evenly(&mut values, RANGE_POINTS);
    if values.is_empty() {
        return [0.0, 1.0];
    }
    let mut quantile = |q: f64| {
        let rank = ((values.len() - 1) as f64 * q).round() as usize;
        *values.select_nth_unstable_by(rank, f32::total_cmp).1
    };
    let (low, high) = (quantile(share), quantile(1.0 - share));
    [low, high.max(low + low.abs().max(1e-3) * 1e-3)]
}

/// A cloud thinned to `budget` points: first the least certain go, at most half of all, then every so many.
fn thinned(points: &[CloudPoint], budget: usize) -> Vec<CloudPoint> {
    let mut points = points.to_vec();
    if points.len() <= budget {
        return points;
    }
    let mut histogram = [0usize; 256];
    points.iter().for_each(|p| histogram[p.sigma_code as usize] += 1);
    let enough = budget.max(points.len() / 2);
    let mut kept = 0;
    let worst = histogram.iter().position(|n| {
        kept += n;
        kept >= enough
    });
    points.retain(|p| worst.is_none_or(|worst| p.sigma_code as usize <= worst));
    evenly(&mut points, budget);
    points
}

/// Keeps `budget` elements, spread evenly over the order of `items`.
pub fn evenly<T>(items: &mut Vec<T>, budget: usize) {
    let count = items.len();
    if count > budget {
        let mut index = 0;
        items.retain(|_| {
            index += 1;
            index * budget / count > (index - 1) * budget / count
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f32, sigma_code: u8) -> CloudPoint {
        CloudPoint {
            position: Vector3::new(x, 0.0, 0.0),
            inverse_depth: 1.0,
            intensity: 0,
            color: None,
            sigma_code,
            keyframe: 0,
        }
    }

    #[test]
    fn thinning_drops_the_uncertain_first_and_meets_the_budget() {
        let points: Vec<_> = (0..1000).map(|i| point(i as f32, if i % 4 == 0 { 200 } else { 10 })).collect();
        let points = thinned(&points, 300);
        assert_eq!(points.len(), 300);
        assert!(points.iter().all(|p| p.sigma_code == 10));
        assert!(points.first().unwrap().position.x < 10.0 && points.last().unwrap().position.x > 990.0);
    }

    #[test]
    fn stray_points_do_not_stretch_the_box() {
        let mut points: Vec<_> = (0..1000).map(|i| point(i as f32 / 1000.0, 0)).collect();
        points.push(point(1e6, 0));
        let (low, high) = robust_box(&points);
        assert!(low.x > -2.0 && low.x < 0.0 && high.x > 1.0 && high.x < 3.0, "{low} {high}");
    }

    #[test]
    fn sigma_codes_order_and_survive_nan() {
        assert_eq!(sigma_code(0.0), 0);
        assert_eq!(sigma_code(f32::NAN), 255);
        assert_eq!(sigma_code(5.0), 255);
        assert!(sigma_code(0.01) < sigma_code(0.02));
    }

    #[test]
    fn a_range_has_width() {
        assert_eq!(range([].into_iter(), 0.1), [0.0, 1.0]);
        let [low, high] = range([3.0].into_iter(), 0.1);
        assert!(low <= 3.0 && high > low);
    }
}
