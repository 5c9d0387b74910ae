//! COLMAP models: images, poses, and sparse points with the images that see them
//! (<https://colmap.github.io/format.html>).

mod binary;
#[cfg(test)]
mod tests;
mod text;

use super::ImportOptions;
use super::build::{self, Built, Posed};
use anyhow::{Context, Result, bail, ensure};
use geometry::limits::check_image_size;
use geometry::{Camera, Distortion, KannalaBrandt, Pinhole, RadTan, Se3, Undistorter};
use map::{Keyframe, KeyframeId, Observation, Point, SemiDense};
use nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where a model lies in a project.
const MODELS: [&str; 3] = [".", "sparse/0", "sparse"];
/// COLMAP puts the centre of the first pixel at a half, loopbox at 0.
const PIXEL_CENTRE: f64 = 0.5;
/// Standard deviation of a key point, pixels.
const PIXEL_DEVIATION: f64 = 1.0;

/// A model as its files have it.
#[derive(Debug, Default, PartialEq)]
struct Model {
    cameras: BTreeMap<u32, Camera>,
    images: Vec<Picture>,
    /// Positions by their ids.
    points: BTreeMap<u64, Vector3<f64>>,
}

/// An image of a model.
#[derive(Clone, Debug, PartialEq)]
struct Picture {
    name: String,
    camera: u32,
    camera_from_world: Se3,
    /// Its key points that are of a 3-D point, and of which; pixels as COLMAP counts them.
    seen: Vec<(Vector2<f64>, u64)>,
}

/// Of a camera model its number, its name, and how many parameters it has.
const CAMERA_MODELS: [(i32, &str, usize); 7] = [
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (5, "OPENCV_FISHEYE", 8),
    (6, "FULL_OPENCV", 12),
];

/// A camera of a model named in `CAMERA_MODELS`, with as many parameters as it has.
fn camera_of(model: &str, width: u64, height: u64, params: &[f64]) -> Result<Camera> {
    let (width, height) = (usize::try_from(width)?, usize::try_from(height)?);
    check_image_size(width, height).map_err(anyhow::Error::msg)?;
    // The simple ones have one focal length.
    let one = matches!(model, "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL");
    let (focal, rest) = params.split_at(if one { 1 } else { 2 });
    let (centre, terms) = rest.split_at(2);
    let (cx, cy) = (centre[0] - PIXEL_CENTRE, centre[1] - PIXEL_CENTRE);
    let intrinsics = Pinhole { width, height, fx: focal[0], fy: focal[focal.len() - 1], cx, cy };
    let distortion = match model {
        "SIMPLE_RADIAL" => Distortion::RadTan(RadTan::new(&[terms[0], 0.0, 0.0, 0.0])?),
        "RADIAL" => Distortion::RadTan(RadTan::new(&[terms[0], terms[1], 0.0, 0.0])?),
        "OPENCV" | "FULL_OPENCV" => Distortion::RadTan(RadTan::new(terms)?),
        "OPENCV_FISHEYE" => Distortion::KannalaBrandt(KannalaBrandt::new(terms)?),
        _ => Distortion::None,
    };
    Ok(Camera::new(intrinsics, distortion)?)
}

/// A pose of a model: `q` is w, x, y, z.
fn pose_of(q: [f64; 4], t: [f64; 3]) -> Result<Se3> {
    let quaternion = Quaternion::new(q[0], q[1], q[2], q[3]);
    let finite = q.iter().chain(&t).all(|v| v.is_finite());
    ensure!(finite && quaternion.norm() > 0.5, "the pose {q:?} {t:?} is none");
    Ok(Se3::new(UnitQuaternion::from_quaternion(quaternion), Vector3::from(t)))
}

/// The folder of the model in a project, and whether it is binary.
pub(super) fn model_in(folder: &Path) -> Option<(PathBuf, bool)> {
    let has = |model: &Path, end: &str| {
        ["cameras", "images", "points3D"].iter().all(|name| model.join(format!("{name}.{end}")).is_file())
    };
    MODELS.iter().map(|model| folder.join(model)).find_map(|model| {
        let binary = has(&model, "bin");
        (binary || has(&model, "txt")).then_some((model, binary))
    })
}

/// Makes the keyframes of a model.
pub(super) fn read(folder: &Path, options: &ImportOptions) -> Result<Built> {
    let Some((place, is_binary)) = model_in(folder) else {
        bail!(
            "{}: holds no COLMAP model\nhint: cameras, images and points3D, all .txt or all .bin, lie in it, in sparse/ or \
             in sparse/0/",
            folder.display()
        );
    };
    let mut model = if is_binary { binary::read(&place)? } else { text::read(&place)? };
    ensure!(!model.images.is_empty(), "{}: the model has no images", place.display());
    model.images.sort_by(|a, b| a.name.cmp(&b.name));
    let mut chosen: Vec<&Picture> = model.images.iter().step_by(options.every).collect();
    let first = camera(&model, chosen[0])?;
    let pinhole = *build::undistorter(first, None)?.pinhole();
    // One map has one camera: the images of all others are made those of the first one's.
    let lenses: BTreeMap<u32, Undistorter> = model
        .cameras
        .iter()
        .map(|(id, camera)| Ok((*id, build::undistorter(camera, Some(pinhole))?)))
        .collect::<Result<_>>()?;
    let count = chosen.len();
    chosen.retain(|picture| picture.seen.iter().any(|(_, point)| model.points.contains_key(point)));
    let blind = count - chosen.len();
    ensure!(!chosen.is_empty(), "{}: no image of the model sees a point", place.display());
    let views: Vec<View> =
        chosen.iter().map(|picture| View::of(picture, &model, pinhole)).collect::<Result<_>>()?;
    let keyframes: Vec<Keyframe> = chosen
        .par_iter()
        .enumerate()
        .map(|(index, picture)| {
            let image = image_file(folder, &picture.name)?;
            let posed = Posed {
                index,
                timestamp: index as f64,
                frame_index: index as u64,
                image: &image,
                world_from_camera: picture.camera_from_world.inverse(),
            };
            let lens = lenses.get(&picture.camera).context("every image has a camera")?;
            Ok(build::keyframe(&posed, build::undistorted(&image, lens)?))
        })
        .collect::<Result<_>>()?;
    let mut keyframes: BTreeMap<KeyframeId, Keyframe> =
        keyframes.into_iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    add_points(&mut keyframes, &views, &model);
    let edges = build::chain(&keyframes);
    let warnings =
        (blind > 0).then(|| format!("{}: {blind} images see no point and were left out", place.display()));
    Ok(Built { camera: pinhole, keyframes, edges, warnings: warnings.into_iter().collect() })
}

/// The camera of an image.
fn camera<'a>(model: &'a Model, picture: &Picture) -> Result<&'a Camera> {
    let found = model.cameras.get(&picture.camera);
    found.with_context(|| {
        format!("image {} is of camera {}, which the model lacks", picture.name, picture.camera)
    })
}

/// The file of an image.
fn image_file(folder: &Path, name: &str) -> Result<PathBuf> {
    let places = [folder.join("images").join(name), folder.join(name)];
    let Some(found) = places.iter().find(|path| path.is_file()) else {
        bail!(
            "{}: is missing\nhint: the images of the model lie in images/ or beside it",
            places[0].display()
        );
    };
    Ok(found.clone())
}

/// What an image sees, in pixels of the pinhole.
struct View {
    pinhole: Pinhole,
    camera_from_world: Se3,
    /// Where it measured the points.
    seen: BTreeMap<u64, Vector2<f64>>,
}

impl View {
    fn of(picture: &Picture, model: &Model, pinhole: Pinhole) -> Result<Self> {
        let camera = camera(model, picture)?;
        let undistorted = |(pixel, point): &(Vector2<f64>, u64)| {
            let ray = camera.unproject(&(pixel - Vector2::repeat(PIXEL_CENTRE)))?;
            (ray.z > 0.0).then(|| (*point, pinhole.project(&ray)))
        };
        let seen = picture.seen.iter().filter(|(_, point)| model.points.contains_key(point));
        Ok(Self {
            pinhole,
            camera_from_world: picture.camera_from_world,
            seen: seen.filter_map(undistorted).collect(),
        })
    }

    /// Pixel and depth of a position; `None` outside the image.
    fn sight(&self, position: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
        let local = self.camera_from_world * *position;
        let pixel = self.pinhole.project(&local);
        let inside = |v: f64, size: usize| v >= 0.0 && v <= size as f64 - 1.0;
        (local.z > 0.0 && inside(pixel.x, self.pinhole.width) && inside(pixel.y, self.pinhole.height))
            .then_some((pixel, local.z))
    }

    /// How much of a pixel the image of a position moves when its depth in another view changes by a part: what that view
    /// learns of it from here.
    fn parallax(&self, position: &Vector3<f64>, other: &View) -> f64 {
        const STEP: f64 = 1e-3;
        let centre = other.camera_from_world.inverse().translation;
        let moved = centre + (position - centre) * (1.0 + STEP);
        match self.sight(position).zip(self.sight(&moved)) {
            Some(((here, _), (there, _))) => (there - here).norm() / STEP,
            None => 0.0,
        }
    }
}

/// Gives every keyframe the depths of the points it sees, and the points that it is the first to see.
fn add_points(keyframes: &mut BTreeMap<KeyframeId, Keyframe>, views: &[View], model: &Model) {
    let mut tracks: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (index, view) in views.iter().enumerate() {
        view.seen.keys().for_each(|point| tracks.entry(*point).or_default().push(index));
    }
    let mut depths: Vec<BTreeMap<u32, (f32, f32)>> = vec![BTreeMap::new(); views.len()];
    for (id, track) in &tracks {
        let position = &model.points[id];
        // What is known of its depth, in parts of it: nothing where all see it from one place.
        let variance = |index: usize| {
            let others = track.iter().filter(|&&other| other != index);
            let square =
                |other: &usize| (views[*other].parallax(position, &views[index]) / PIXEL_DEVIATION).powi(2);
            others.map(square).sum::<f64>().recip()
        };
        let sights: Vec<Option<(Vector2<f64>, f64, f64)>> = track
            .iter()
            .map(|&index| {
                let (pixel, depth) = views[index].sight(position)?;
                Some((pixel, depth, variance(index))).filter(|(.., variance)| variance.is_finite())
            })
            .collect();
        for (&index, sight) in track.iter().zip(&sights) {
            let &Some((pixel, depth, variance)) = sight else { continue };
            let at = pixel.y.round() as u32 * views[index].pinhole.width as u32 + pixel.x.round() as u32;
            let (inverse, spread) = (depth.recip() as f32, (variance / (depth * depth)) as f32);
            let kept = depths[index].entry(at).or_insert((inverse, spread));
            // Of two in one pixel the nearer hides the other.
            if inverse > kept.0 {
                *kept = (inverse, spread);
            }
        }
        let Some(keyframe) = keyframes.get_mut(&KeyframeId(track[0] as u32)) else { continue };
        if let Some((pixel, depth, variance)) = sights[0] {
            let observation = |&other: &usize| Observation {
                keyframe: KeyframeId(other as u32),
                pixel: [views[other].seen[id].x as f32, views[other].seen[id].y as f32],
                information: [PIXEL_DEVIATION.powi(-2) as f32, 0.0, PIXEL_DEVIATION.powi(-2) as f32],
            };
            keyframe.points.push(Point {
                pixel: [pixel.x as f32, pixel.y as f32],
                inverse_depth: depth.recip() as f32,
                variance: (variance / (depth * depth)) as f32,
                observations: track[1..].iter().map(observation).collect(),
            });
        }
    }
    for (keyframe, depths) in keyframes.values_mut().zip(depths) {
        let mut semi_dense = SemiDense::default();
        for (pixel, (inverse_depth, variance)) in depths {
            semi_dense.pixel.push(pixel);
            semi_dense.inverse_depth.push(inverse_depth);
            semi_dense.variance.push(variance);
        }
        keyframe.semi_dense = semi_dense.into();
    }
}
