//! The board found in image after image, and which images are worth keeping.

use super::input::Shots;
use anyhow::{Result, bail};
use boards::Detector;
use calib::coach::{Coverage, coverage, is_new_view};
use calib::{Board, Corner, View, edge_width};
use geometry::GrayImage;
use nalgebra::Vector2;
use rayon::prelude::*;

/// Edges wider than this make an image blurred, pixels; 2 is sharp.
const MAX_EDGE_WIDTH: f64 = 6.0;
/// Most pixels looked at around a corner to tell how sharp it is.
const MAX_RADIUS: f64 = 12.0;
/// Images worked on at a time; few of a stream, so that who holds the board sees at once what comes of it.
const BATCH: usize = 16;
const STREAM_BATCH: usize = 4;
/// Views of a recording that are enough.
const MAX_VIEWS: usize = 100;
/// Images that are looked at for what else they show when no board was found.
const LOOKED_AT: usize = 3;

/// An image in which the board was looked for.
pub struct Shot {
    pub name: String,
    pub image: GrayImage,
    pub corners: Vec<Corner>,
    /// Width of the edges at the corners, pixels.
    pub edge_width: Option<f64>,
    /// Why it does not count.
    pub problem: Option<String>,
}

/// The images and views so far.
pub struct CollectProgress<'a> {
    /// Images looked at.
    pub given: usize,
    /// Which parts of the image the views cover.
    pub coverage: &'a Coverage,
    /// The views that count.
    pub views: &'a [View],
    /// The newest image.
    pub newest: Option<&'a Shot>,
    /// Whether it is one of the views that count.
    pub kept: bool,
}

/// All images that count or were meant to.
pub struct Collected {
    /// Width and height of the images, pixels.
    pub size: (usize, usize),
    /// The images.
    pub shots: Vec<Shot>,
    /// Images looked at.
    pub given: usize,
    /// Which parts of the image the views cover.
    pub coverage: Coverage,
}

impl Collected {
    /// The views to calibrate from, in the order of [`shots`](Self::shots); those that do not count have no corners.
    pub fn views(&self) -> Vec<View> {
        let view = |shot: &Shot| View {
            name: shot.name.clone(),
            corners: if shot.problem.is_some() { Vec::new() } else { shot.corners.clone() },
        };
        self.shots.iter().map(view).collect()
    }
}

/// Looks for the board in all images. `more` is told what was seen after each batch, and says whether to go on.
///
/// # Errors
/// When an image file cannot be read, images differ in size, or no image shows the board; says what they show instead.
pub fn collect(
    shots: &mut Shots,
    board: &Board,
    window: Option<u16>,
    more: &mut dyn FnMut(&CollectProgress) -> bool,
) -> Result<Collected> {
    let detector = Detector::new(board, window)?;
    let stream = shots.is_stream();
    let mut size = None;
    let (mut kept, mut views, mut given): (Vec<Shot>, Vec<View>, usize) = (Vec::new(), Vec::new(), 0);
    let mut empty: Vec<GrayImage> = Vec::new();
    let mut seen = Coverage::default();
    loop {
        let images = batch(shots, stream, &mut size)?;
        if images.is_empty() {
            break;
        }
        given += images.len();
        let found: Vec<Result<Shot>> =
            images.into_par_iter().map(|(name, image)| shot(&detector, board, name, image)).collect();
        let mut passed = None;
        for shot in found {
            let shot = shot?;
            if shot.corners.is_empty() && empty.len() < LOOKED_AT {
                empty.push(shot.image.clone());
            }
            let view = View { name: shot.name.clone(), corners: shot.corners.clone() };
            let size = (shot.image.width(), shot.image.height());
            let counts = shot.problem.is_none();
            if stream && !(counts && is_new_view(&views, &view, size)) {
                passed = Some(shot);
                continue;
            }
            passed = None;
            if counts {
                views.push(view);
            }
            kept.push(shot);
        }
        seen = coverage(board, &views, size.unwrap_or((1, 1)));
        let newest = passed.as_ref().or(kept.last());
        let kept = passed.is_none() && newest.is_some_and(|shot| shot.problem.is_none());
        if !more(&CollectProgress { given, coverage: &seen, views: &views, newest, kept })
            || (stream && views.len() >= MAX_VIEWS)
        {
            break;
        }
    }
    let Some(size) = size else {
        bail!("there are no images\nhint: give image files, a folder or a recording")
    };
    if views.is_empty() && kept.iter().all(|shot| shot.corners.is_empty()) {
        let what = detector.what_else(&empty);
        bail!("no image of {given} shows the board {board}: {what}");
    }
    check_order(&detector, board, &views)?;
    Ok(Collected { size, shots: kept, given, coverage: seen })
}

/// Refuses a grid of tags whose numbers run otherwise than on the board that is asked for.
fn check_order(detector: &Detector, board: &Board, views: &[View]) -> Result<()> {
    if let (Detector::AprilGrid(grid), Some(view)) =
        (detector, views.iter().max_by_key(|view| view.corners.len()))
        && let Some(order) = grid.wrong_order(&view.corners)
    {
        bail!(
            "{}: the tags' numbers do not run as on {board} but {order}\nhint: print the board anew, not mirrored, or check its \
             columns and rows",
            view.name
        );
    }
    Ok(())
}

/// The next images.
fn batch(
    shots: &mut Shots,
    stream: bool,
    size: &mut Option<(usize, usize)>,
) -> Result<Vec<(String, GrayImage)>> {
    let mut images = Vec::new();
    while images.len() < if stream { STREAM_BATCH } else { BATCH } {
        let Some((name, image)) = shots.next_shot() else { break };
        let image = match image {
            Ok(image) => image,
            // A recording may have a broken frame.
            Err(_) if stream => continue,
            Err(reason) => {
                bail!(
                    "{reason}\nhint: remove the file or give it anew; PNG, JPEG, PGM, TIFF and BMP are read"
                )
            }
        };
        let own = (image.width(), image.height());
        let first = *size.get_or_insert(own);
        if own != first {
            bail!(
                "{name}: has {}×{} pixels, the images before have {}×{}\nhint: calibrate from images of one camera in one mode",
                own.0,
                own.1,
                first.0,
                first.1
            );
        }
        images.push((name, image));
    }
    Ok(images)
}

fn shot(detector: &Detector, board: &Board, name: String, image: GrayImage) -> Result<Shot> {
    let corners = detector.corners(&image)?;
    let pixels: Vec<Vector2<f64>> = corners.iter().map(|corner| corner.pixel).collect();
    let radius = (0.4 * corner_distance(board, &corners)).clamp(2.0, MAX_RADIUS) as usize;
    let edge_width = edge_width(&image, &pixels, radius);
    let problem = if corners.is_empty() {
        Some("the board was not found".into())
    } else {
        // Where corners lie close together, narrower edges are already blurred.
        edge_width.filter(|width| *width > MAX_EDGE_WIDTH).map(|width| {
            format!("blurred: edges are {width:.1} px wide, at most {MAX_EDGE_WIDTH:.0} are sharp enough")
        })
    };
    Ok(Shot { name, image, corners, edge_width, problem })
}

/// Median distance of corners that are neighbours on the board, pixels.
fn corner_distance(board: &Board, corners: &[Corner]) -> f64 {
    let points = board.points();
    let least = board.corner_distance();
    let mut distances: Vec<f64> = corners
        .iter()
        .flat_map(|a| {
            let near = |b: &&Corner| {
                let apart = (points[a.index] - points[b.index]).norm();
                apart > 0.0 && apart < 1.05 * least
            };
            corners.iter().filter(near).map(|b| (a.pixel - b.pixel).norm()).collect::<Vec<f64>>()
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(2.0 * MAX_RADIUS)
}
