//! SIFT by OpenCV.

use crate::{Descriptor, Extractor, Features, Keypoint, SiftError, SiftParams};
use ::opencv::core::{self, CV_8U, KeyPoint, Mat, Vector, no_array};
use ::opencv::features2d::SIFT;
use ::opencv::prelude::*;
use geometry::{GrayImage, Pyramid};
use std::sync::LazyLock;

/// SIFT by the system's OpenCV.
#[derive(Clone, Debug, Default)]
pub struct OpenCvSift(pub SiftParams);

impl Extractor for OpenCvSift {
    fn extract(&self, image: &GrayImage) -> Result<Features, SiftError> {
        let (width, height) = (image.width(), image.height());
        detect(image, &self.0).map_err(|source| SiftError::OpenCv { width, height, source })
    }
}

/// Whether OpenCV keeps to one thread an image: callers extract several images at once. Set once, because setting
/// it while another thread works makes OpenCV take down the pool under it.
static SINGLE_THREADED: LazyLock<bool> = LazyLock::new(|| core::set_num_threads(0).is_ok());

/// How far OpenCV's key points lie right of and below their places, pixels: it looks for them in an image of twice the
/// size, whose pixel x lies at x/2 − 1/4, and reports x/2.
const UPSCALE_SHIFT: f32 = 0.25;

fn detect(image: &GrayImage, params: &SiftParams) -> ::opencv::Result<Features> {
    LazyLock::force(&SINGLE_THREADED);
    let pyramid = Pyramid::new(image.clone(), params.halvings + 1);
    let level = pyramid.len() - 1;
    let image = pyramid.level(level);
    let pixels = Mat::from_slice(image.data())?;
    let pixels = pixels.reshape(1, image.height() as i32)?;
    let count = i32::try_from(params.max_features).unwrap_or(i32::MAX);
    let mut detector = SIFT::create_with_descriptor_type(count, 3, params.contrast, 10.0, 1.6, CV_8U)?;
    let (mut found, mut described) = (Vector::<KeyPoint>::new(), Mat::default());
    detector.detect_and_compute(&pixels, &no_array(), &mut found, &mut described, false)?;

    // Of equal strength the first in the image, so that the order is one.
    let mut order: Vec<usize> = (0..found.len()).collect();
    let keypoints: Vec<KeyPoint> = found.iter().collect();
    order.sort_by(|&a, &b| keypoints[b].response().total_cmp(&keypoints[a].response()).then(a.cmp(&b)));
    order.truncate(params.max_features);
    let unit = (1 << level) as f32;
    let whole = |v: f32| (v - UPSCALE_SHIFT + 0.5) * unit - 0.5;
    let mut features = Features::default();
    for index in order {
        let keypoint = &keypoints[index];
        features.keypoints.push(Keypoint {
            pixel: [whole(keypoint.pt().x), whole(keypoint.pt().y)],
            size: keypoint.size() * unit,
            angle: keypoint.angle().to_radians(),
        });
        features.descriptors.push(root_sift(described.at_row::<u8>(index as i32)?));
    }
    Ok(features)
}

/// Turns a SIFT descriptor into a RootSIFT one.
fn root_sift(histogram: &[u8]) -> Descriptor {
    let sum = histogram.iter().map(|&v| f32::from(v)).sum::<f32>().max(1.0);
    std::array::from_fn(|i| (256.0 * (f32::from(histogram[i]) / sum).sqrt()).round().min(255.0) as u8)
}
