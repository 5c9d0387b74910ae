//! SIFT (Lowe 2004) in Rust alone, made from the published algorithm.
//!
//! Read in this order: [`scale_space`], [`extrema`], [`noise`], [`orientation`], [`patch`], [`descriptor`]. All arithmetic is in one fixed
//! order and takes nothing from the system's mathematical library, so the features are the same to the bit on every
//! machine.

mod blur;
mod descriptor;
mod extrema;
mod noise;
mod orientation;
mod patch;
mod scale_space;
mod window;

use crate::numbers::exp2;
use crate::{Features, Keypoint, SiftParams};
use descriptor::Describer;
use extrema::{Extremum, extrema};
use geometry::{GrayImage, Image, Pyramid};
use scale_space::{LAYERS, Octave, Placed, SIGMA, Scales, first};
use window::Window;

geometry::multiversion! {
    /// Finds and describes the features of an image, strongest first.
    pub fn detect(image: &GrayImage, params: &SiftParams) -> Features {
        // Halved and then doubled is the image itself, but sharper.
        let double = params.halvings == 0;
        let pyramid = Pyramid::new(image.clone(), params.halvings.max(1));
        let level = pyramid.len() - 1;
        let unit = (1usize << level) as f32;
        let (first, placed) = first(pyramid.level(level), double);
        let placed = Placed { scale: placed.scale * unit, offset: (placed.offset + 0.5) * unit - 0.5 };

        // As OpenCV counts it: of a full scale of one, and divided by the layers.
        let contrast = (params.contrast * 255.0 / LAYERS as f64) as f32;
        let (mut octaves, mut differences, mut found) = (Vec::new(), Vec::new(), Vec::new());
        let (mut scales, mut next) = (Scales::new(), first);
        while let Some((octave, of_octave)) = scales.octave(next) {
            extrema(octaves.len(), &of_octave, contrast, &mut found);
            next = octave.next();
            octaves.push(octave);
            differences.push(of_octave);
        }
        let mut most = params.max_features;
        if found.len() < params.least_features {
            most = params.least_features.min(most);
            let above_noise = params.least_deviations as f32 * noise::deviation(&differences);
            weaker(&differences, above_noise, contrast, &mut found);
        }

        // Of equal strength the first in the image, so that the order is one.
        found.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
        // Each has an orientation at least.
        found.truncate(most);
        described(&octaves, &found, placed, params.max_features)
    }
}

/// Finds the extrema again that have at least the contrast `least`, grey levels, where it is below that of those `found`.
#[inline(always)]
fn weaker(differences: &[Vec<Image<f32>>], least: f32, found_from: f32, found: &mut Vec<Extremum>) {
    if least < found_from {
        found.clear();
        for (octave, of_octave) in differences.iter().enumerate() {
            extrema(octave, of_octave, least, found);
        }
    }
}

/// The features of extrema, in their order, at most `most`.
#[inline(always)]
fn described(octaves: &[Octave], extrema: &[Extremum], placed: Placed, most: usize) -> Features {
    let (mut window, mut describer) = (Window::default(), Describer::new());
    let mut turns = Vec::new();
    let mut all = Features::default();
    for extremum in extrema {
        let image = &octaves[extremum.octave].images[extremum.layer];
        let unit = placed.scale * (1u32 << extremum.octave) as f32;
        let sigma = (SIGMA * exp2(f64::from(extremum.scale) / LAYERS as f64)) as f32;
        turns.clear();
        orientation::orientations(image, extremum.pixel, sigma, &mut window, &mut turns);
        turns.truncate(most - all.len());
        for &turns in &turns {
            all.keypoints.push(Keypoint {
                pixel: extremum.pixel.map(|v| v * unit + placed.offset),
                size: 2.0 * sigma * unit,
                angle: turns * std::f32::consts::TAU,
            });
            all.descriptors.push(describer.describe(image, extremum.pixel, sigma, turns));
        }
        if all.len() == most {
            break;
        }
    }
    all
}
