//! Measures the depth filter against exact depth, with exact poses.
//!
//! ```text
//! cargo run --release -p loopbox-slam-direct --example depth_parking -- DATA [OUT] [SEQUENCE…]
//! ```
//! `DATA` holds the sequences (`parking_a`, …); with `OUT`, depth and error maps of a few keyframes are
//! written there as PNG. `DEPTH_PARAMS` takes a JSON object of parameters over the defaults, `DEPTH_STRIDE=6`
//! leaves only every sixth frame as reference, `DEPTH_VERBOSE=1` tells of each update. The sparse backbone is simulated: 800 pixels with 1 % noise and 2 % outliers.

#[path = "../tests/support/parking.rs"]
mod parking;

use geometry::sensor::Shift;
use geometry::{GrayImage, Image, Se3};
use parking::{Result, Sequence, backbone};
use slam_direct::{DepthFilter, DepthParams, StereoFrame, UpdateStats, choose_references};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Frames on either side of a keyframe that may serve as references.
const REACH: usize = 16;
/// Milliseconds of CPU this thread has used, or of time where the system does not tell.
fn cpu_milliseconds(since: Instant) -> f64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok())
        .map_or(1e3 * since.elapsed().as_secs_f64(), |ns| 1e-6 * ns)
}

/// Errors of all exported pixels.
#[derive(Default)]
struct Tally {
    relative: Vec<f32>,
    normalised2: Vec<f32>,
    without_truth: usize,
    pixels: usize,
    candidates: usize,
    milliseconds: Vec<f64>,
    stages: [f64; 4],
    references: usize,
}

impl Tally {
    fn add(&mut self, filter: &DepthFilter, truth: &Image<f32>) {
        self.pixels += truth.data().len();
        self.candidates += filter.len();
        for (pixel, d, v) in filter.to_semi_dense().iter() {
            let exact = truth.data()[pixel as usize];
            if exact == 0.0 {
                self.without_truth += 1;
                continue;
            }
            self.relative.push((d - exact).abs() / exact);
            self.normalised2.push((d - exact) * (d - exact) / v);
        }
    }

    fn print(&mut self, name: &str) {
        let count = self.relative.len().max(1);
        self.relative.sort_by(f32::total_cmp);
        self.normalised2.sort_by(f32::total_cmp);
        self.milliseconds.sort_by(f64::total_cmp);
        let at = |v: &[f32], q: f32| v.get((q * v.len() as f32) as usize).copied().unwrap_or(f32::NAN);
        let outliers = self.relative.iter().filter(|&&r| r > 0.1).count() + self.without_truth;
        let inliers: Vec<f32> = self.normalised2.iter().copied().filter(|&n| n < 16.0).collect();
        let frames = self.milliseconds.len().max(1);
        println!(
            "{name}: median {:.3} %, 90th {:.2} %, outliers {:.2} % (no truth {:.2} %), density {:.1} % of {:.1} % candidates, \
             normalised²: median {:.2} (0.45), below 16: mean {:.2} of {:.1} %; {:.1} references; CPU mean {:.1} ms, max {:.1} ms \
             (new {:.1}, seed {:.1}, update {:.1}, regularise {:.1})",
            100.0 * at(&self.relative, 0.5),
            100.0 * at(&self.relative, 0.9),
            100.0 * outliers as f32 / (count + self.without_truth) as f32,
            100.0 * self.without_truth as f32 / (count + self.without_truth) as f32,
            100.0 * count as f32 / self.pixels as f32,
            100.0 * self.candidates as f32 / self.pixels as f32,
            at(&self.normalised2, 0.5),
            inliers.iter().sum::<f32>() / inliers.len().max(1) as f32,
            100.0 * inliers.len() as f32 / count as f32,
            self.references as f32 / frames as f32,
            self.milliseconds.iter().sum::<f64>() / frames as f64,
            self.milliseconds.last().copied().unwrap_or(0.0),
            self.stages[0] / frames as f64,
            self.stages[1] / frames as f64,
            self.stages[2] / frames as f64,
            self.stages[3] / frames as f64,
        );
    }
}

/// Maps one keyframe; returns the filter and the totals of its updates.
fn map_keyframe(
    sequence: &Sequence,
    index: usize,
    truth: &Image<f32>,
    params: &DepthParams,
    tally: &mut Tally,
) -> Result<DepthFilter> {
    let image = sequence.image(index)?;
    let known: Vec<f32> = truth.data().iter().copied().filter(|&d| d > 0.0).collect();
    let mean = known.iter().sum::<f32>() / known.len().max(1) as f32;
    let last = sequence.world_from_camera.len() - 1;
    let stride = std::env::var("DEPTH_STRIDE").map_or(Ok(1), |text| text.parse::<usize>())?.max(1);
    let around: Vec<usize> = (index.saturating_sub(REACH)..=(index + REACH).min(last))
        .filter(|&i| i != index && i.abs_diff(index).is_multiple_of(stride))
        .collect();
    let poses: Vec<Se3> = around
        .iter()
        .map(|&i| sequence.world_from_camera[i].inverse() * sequence.world_from_camera[index])
        .collect();
    let chosen = choose_references(&poses, mean, &sequence.camera, params);
    let images: Result<Vec<GrayImage>> = chosen.iter().map(|&c| sequence.image(around[c])).collect();
    let images = images?;
    let points = backbone(truth, &mut geometry::Random::new(index as u64 + 1));

    let clock = Instant::now();
    let now = || cpu_milliseconds(clock);
    let start = now();
    let shift = Shift::none(sequence.camera);
    let mut filter = DepthFilter::new(&image, &sequence.camera, shift, params);
    let made = now();
    filter.seed(&points);
    let seeded = now();
    let mut stats: Vec<(UpdateStats, f64)> = Vec::new();
    for (&c, reference) in chosen.iter().zip(&images) {
        let frame = StereoFrame {
            image: reference,
            frame_from_keyframe: poses[c],
            brightness: (0.0, 0.0),
            pose_sigma_px: 0.05,
            shift,
        };
        let before = now();
        stats.push((filter.update(&image, &frame), now() - before));
    }
    let updated = now();
    filter.regularise();
    let done = now();
    tally.milliseconds.push(done - start);
    let stages = [made - start, seeded - made, updated - seeded, done - updated];
    tally.stages.iter_mut().zip(stages).for_each(|(sum, stage)| *sum += stage);
    tally.references += chosen.len();
    if std::env::var_os("DEPTH_VERBOSE").is_some() {
        for (&c, (s, ms)) in chosen.iter().zip(&stats) {
            println!("  {index} with {}: {s:?} {ms:.1} ms", around[c]);
        }
    }
    tally.add(&filter, truth);
    Ok(filter)
}

/// Colours from red (near) over green to blue (far).
fn colour(value: f32) -> [u8; 3] {
    let v = value.clamp(0.0, 1.0);
    let channel = |centre: f32| (255.0 * (1.5 - (4.0 * (v - centre)).abs()).clamp(0.0, 1.0)) as u8;
    [channel(0.75), channel(0.5), channel(0.25)]
}

/// Writes the inverse depth over the image, and the errors (green right, red beyond 5 %, white no truth).
fn render(
    sequence: &Sequence,
    index: usize,
    filter: &DepthFilter,
    truth: &Image<f32>,
    out: &Path,
) -> Result<()> {
    let image = sequence.image(index)?;
    let (width, height) = (image.width() as u32, image.height() as u32);
    let grey = |p: usize| [image.data()[p] / 2; 3];
    let mut depth = image::RgbImage::new(width, height);
    let mut error = image::RgbImage::new(width, height);
    for p in 0..image.data().len() {
        let (x, y) = (p as u32 % width, p as u32 / width);
        depth.put_pixel(x, y, image::Rgb(grey(p)));
        error.put_pixel(x, y, image::Rgb(grey(p)));
    }
    let map = filter.to_semi_dense();
    let largest = map.inverse_depth.iter().fold(0.0f32, |a, &b| a.max(b));
    for (pixel, d, _) in map.iter() {
        let (x, y) = (pixel % width, pixel / width);
        let exact = truth.data()[pixel as usize];
        depth.put_pixel(x, y, image::Rgb(colour(d / largest)));
        let shade = match (d - exact).abs() / exact {
            r if r.is_infinite() => [255; 3],
            r => [(255.0 * (r / 0.05).min(1.0)) as u8, (255.0 * (1.0 - r / 0.05).max(0.0)) as u8, 0],
        };
        error.put_pixel(x, y, image::Rgb(shade));
    }
    let name = sequence.folder.file_name().unwrap_or_default().to_string_lossy();
    depth.save(out.join(format!("{name}_{index:06}_depth.png")))?;
    error.save(out.join(format!("{name}_{index:06}_error.png")))?;
    Ok(())
}

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let Some(data) = arguments.next() else {
        return Err("usage: depth_parking DATA [OUT] [SEQUENCE…]".into());
    };
    let out = arguments.next().filter(|o| !o.as_os_str().is_empty());
    if let Some(out) = &out {
        std::fs::create_dir_all(out)?;
    }
    let mut names: Vec<PathBuf> = arguments.collect();
    if names.is_empty() {
        names = ["parking_a", "parking_b", "parking_c"].map(PathBuf::from).to_vec();
    }
    let params = overridden(DepthParams::default())?;
    for name in names {
        let sequence = Sequence::open(&data.join(&name))?;
        let mut tally = Tally::default();
        for index in (0..sequence.world_from_camera.len()).step_by(10) {
            let Some(truth) = sequence.inverse_depth(index)? else { continue };
            let filter = map_keyframe(&sequence, index, &truth, &params, &mut tally)?;
            if let Some(out) = out.as_ref().filter(|_| index % 50 == 0) {
                render(&sequence, index, &filter, &truth, out)?;
            }
        }
        tally.print(&name.to_string_lossy());
    }
    Ok(())
}

/// Takes `DEPTH_PARAMS`, a JSON object, over the defaults.
fn overridden(params: DepthParams) -> Result<DepthParams> {
    match std::env::var("DEPTH_PARAMS") {
        Ok(text) => Ok(serde_json::from_str(&text)?),
        Err(_) => Ok(params),
    }
}
