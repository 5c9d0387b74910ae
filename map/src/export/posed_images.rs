//! A map as posed images with sparse points and their tracks: what structure-from-motion tools exchange.

use super::save;
use crate::io::{encode_color_png, encode_png};
use crate::{AgentId, AgentInfo, Colors, Keyframe, KeyframeId, Map, MapError, SensorKind};
use geometry::sensor::{Rectification, Shift};
use geometry::{Pinhole, Se3};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// The folder of the images within that of an export.
pub(super) const IMAGES: &str = "images";

/// Tools of computer vision that count pixels from the corner of the first one put its centre at a half.
pub(super) const PIXEL_CENTRE: f64 = 0.5;

/// A map of cameras as posed images and points.
pub(super) struct PosedImages<'a> {
    /// The cameras by their agents, pixel centres at integers.
    pub cameras: Vec<(AgentId, &'a Pinhole)>,
    /// The images, in order of keyframes.
    pub images: Vec<PosedImage<'a>>,
    /// The points that two images see at least.
    pub points: Vec<SparsePoint>,
}

/// An image with its pose.
pub(super) struct PosedImage<'a> {
    /// As an ideal camera would have taken it: what takes this in knows pinhole cameras.
    pub keyframe: Cow<'a, Keyframe>,
    /// What made it so, and the keyframe as it is in the map, which has the colours.
    rectification: Option<Rectification>,
    taken: &'a Keyframe,
    /// Its file within [`IMAGES`].
    pub name: String,
    pub camera_from_world: Se3,
}

/// A point with all that sees it.
pub(super) struct SparsePoint {
    /// In the world, map units.
    pub position: Vector3<f64>,
    /// Red, green and blue of its pixel, 0–255; alike where the source was grey.
    pub color: [u8; 3],
    /// Root mean square distance of its observations from its projections, pixels.
    pub error: f64,
    /// The images that see it, by their places in [`PosedImages::images`], and where: its host first, each image once.
    pub track: Vec<(usize, Vector2<f64>)>,
}

impl<'a> PosedImages<'a> {
    /// # Errors
    /// [`MapError::Sensor`] when a LiDAR is among the agents.
    pub fn of(map: &'a Map) -> Result<Self, MapError> {
        let camera = |(id, info): (&AgentId, &'a AgentInfo)| match info.camera() {
            Some(camera) => Ok((*id, camera)),
            None => Err(MapError::Sensor {
                agent: info.name.clone(),
                found: SensorKind::Lidar,
                wanted: SensorKind::Camera,
            }),
        };
        let cameras = map.agents.iter().map(camera).collect::<Result<_, _>>()?;
        let labels = map.agent_labels();
        let image = |&taken: &&'a Keyframe| {
            let (keyframe, rectification) = match map.rectified(taken) {
                Some(rectified) => (Cow::Owned(rectified.keyframe), Some(rectified.rectification)),
                None => (Cow::Borrowed(taken), None),
            };
            let name = format!("{}-{:06}.png", labels[&taken.agent], taken.frame_index);
            let camera_from_world = taken.world_from_keyframe.rigid().inverse();
            PosedImage { keyframe, rectification, taken, name, camera_from_world }
        };
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let images: Vec<PosedImage> = keyframes.par_iter().map(image).collect();
        let places: BTreeMap<KeyframeId, usize> =
            images.iter().enumerate().map(|(place, image)| (image.keyframe.id, place)).collect();
        let shifts: Vec<Shift> = keyframes.iter().filter_map(|keyframe| map.image_shift(keyframe)).collect();
        let hosts = 0..images.len();
        let points = hosts.flat_map(|host| points_of(map, &images, &shifts, host, &places));
        Ok(Self { cameras, points: points.collect(), images })
    }

    /// Writes the images as PNG files into `folder`, which is made.
    pub fn save_images(&self, folder: &Path) -> Result<(), MapError> {
        std::fs::create_dir_all(folder).map_err(|reason| MapError::write(folder, reason))?;
        self.images
            .par_iter()
            .try_for_each(|image| save(&folder.join(&image.name), |out| out.write_all(&image.png()?)))
    }
}

impl PosedImage<'_> {
    /// The image as a PNG file, in colour where the keyframe has colours.
    fn png(&self) -> io::Result<Vec<u8>> {
        let image = &self.keyframe.image;
        let Some(colors) = self.taken.colors() else { return encode_png(image) };
        let planes = colors.planes(image.width(), image.height());
        let planes = match &self.rectification {
            Some(rectification) => planes.map(|plane| rectification.image(&plane)),
            None => planes,
        };
        encode_color_png((image.width(), image.height()), &colors.painted(image, &planes))
    }
}

/// The points that the image `host` hosts, where others see them too.
fn points_of(
    map: &Map,
    images: &[PosedImage],
    shifts: &[Shift],
    host: usize,
    places: &BTreeMap<KeyframeId, usize>,
) -> Vec<SparsePoint> {
    let keyframe = &images[host].keyframe;
    let colors = images[host].taken.colors();
    let point = |(point, taken): (&crate::Point, &crate::Point)| {
        let [x, y] = point.pixel.map(f64::from);
        let ray = map.camera(keyframe).unproject(x, y);
        let position = keyframe.world_from_keyframe * (ray / f64::from(point.inverse_depth));
        let mut track = vec![(host, Vector2::new(x, y))];
        for seen in &point.observations {
            if let Some(&place) = places.get(&seen.keyframe)
                && track.iter().all(|(other, _)| *other != place)
            {
                let image = &images[place];
                let unit = image.keyframe.world_from_keyframe.scale;
                let inverse_depth = unit / (image.camera_from_world * position).z;
                let shift = shifts[place].to_undistorted(seen.pixel, inverse_depth as f32);
                track.push((place, Vector2::from([0, 1].map(|i| f64::from(seen.pixel[i] + shift[i])))));
            }
        }
        let squared_error = |(place, pixel): &(usize, Vector2<f64>)| {
            let local = images[*place].camera_from_world * position;
            (map.camera(&images[*place].keyframe).project(&local) - pixel).norm_squared()
        };
        let error = (track.iter().map(squared_error).sum::<f64>() / track.len() as f64).sqrt();
        let color = color_at(keyframe, colors.as_ref(), (point.pixel, taken.pixel));
        SparsePoint { position, color, error, track }
    };
    // Rectified points are in the order of those that were taken.
    let points = keyframe.points.iter().zip(&images[host].taken.points).map(point);
    points
        .filter(|p| p.track.len() > 1 && p.error.is_finite() && p.position.iter().all(|v| v.is_finite()))
        .collect()
}

/// The colour of a keyframe's image at a pixel, whose colours lie at `taken`; black outside of the image.
fn color_at(keyframe: &Keyframe, colors: Option<&Colors>, (pixel, taken): ([f32; 2], [f32; 2])) -> [u8; 3] {
    let (width, height) = (keyframe.image.width(), keyframe.image.height());
    let within = |pixel: [f32; 2]| {
        let [x, y] = pixel.map(|place| place.round() as usize);
        (x < width && y < height).then_some((x, y))
    };
    let Some((x, y)) = within(pixel) else { return [0; 3] };
    let grey = keyframe.image.get(x, y);
    match (colors, within(taken)) {
        (Some(colors), Some((x, y))) => colors.at(x, y, grey),
        _ => [grey; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{lidar_map, sample_map};

    #[test]
    fn points_lie_where_their_hosts_see_them_and_are_seen_once_by_an_image() {
        let map = sample_map(4);
        let posed = PosedImages::of(&map).unwrap();
        assert_eq!(posed.images.len(), 4);
        assert!(!posed.points.is_empty());
        for point in &posed.points {
            let (host, pixel) = point.track[0];
            let image = &posed.images[host];
            let local = image.camera_from_world * point.position;
            assert!((map.camera(&image.keyframe).project(&local) - pixel).norm() < 1e-6);
            let mut seen: Vec<usize> = point.track.iter().map(|(place, _)| *place).collect();
            seen.sort();
            seen.dedup();
            assert_eq!(seen.len(), point.track.len());
        }
    }

    #[test]
    fn a_lidars_map_has_no_images() {
        assert!(matches!(PosedImages::of(&lidar_map(1)), Err(MapError::Sensor { .. })));
    }
}
