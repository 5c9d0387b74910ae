//! Kalibr's grids of AprilTags.
//!
//! OpenCV's detector finds about half of the tags: the black squares between them join their outlines. The others follow
//! from those: where a tag must be, by its neighbours, its corners are looked for and its bits are read.

use super::sub_pixel::{refined, vector};
use super::{mat, mirrored};
use anyhow::Result;
use calib::planar::{homography, mapped};
use calib::{Board, Corner};
use geometry::GrayImage;
use nalgebra::{Matrix3, Vector2, Vector3};
use opencv::aruco::{
    DICT_APRILTAG_36h11, DetectorParameters, Dictionary, detect_markers, get_predefined_dictionary_i32,
};
use opencv::core::{Mat, Point2f, Ptr, Vector, no_array};
use opencv::prelude::*;
use std::collections::BTreeMap;

/// Corners in the order of [`Board::points`] of a tag's corners as OpenCV orders them: its tags are upright when
/// Kalibr's stand on their heads.
const ORDER: [usize; 4] = [1, 0, 3, 2];
/// Part of a tag's side that is looked at around a corner: less than the squares between the tags and the tag's border.
const WINDOW: f64 = 0.16;
/// Tags are not looked for below this side, pixels.
const MIN_SIDE: f64 = 10.0;
/// Most wrong bits of a tag that must be there: its neighbours say which one it is.
const MAX_WRONG_BITS: i32 = 3;
/// Neighbouring tags that say where another one must be.
const NEIGHBOURS: usize = 5;
/// Most share of a tag's side that corners may be off a homography of the whole grid; lenses bend it.
const MAX_BEND: f64 = 0.5;

type Tag = [Vector2<f64>; 4];

/// A grid of tags 36h11.
pub struct AprilGrid {
    columns: usize,
    rows: usize,
    points: Vec<Vector3<f64>>,
}

impl AprilGrid {
    pub fn new(board: &Board, columns: usize, rows: usize) -> Result<Self> {
        Ok(Self { columns, rows, points: board.points() })
    }

    pub fn corners(&self, image: &GrayImage) -> Result<Vec<Corner>> {
        let pixels = mat(image)?;
        let dictionary = get_predefined_dictionary_i32(DICT_APRILTAG_36h11)?;
        // Kalibr's tags have a border of two bits, others of one.
        for border in [2, 1] {
            let found = self.tags(&pixels, &dictionary, border)?;
            if found.is_empty() {
                continue;
            }
            let mut sure = BTreeMap::new();
            for (id, rough) in found {
                if let Some(tag) = refined_tag(&pixels, &rough, 0.15)? {
                    sure.insert(id, tag);
                }
            }
            self.complete(image, &pixels, &dictionary, border, &mut sure)?;
            let corner =
                |(id, tag): (usize, Tag)| (0..4).map(move |k| Corner { index: 4 * id + k, pixel: tag[k] });
            return Ok(sure.into_iter().flat_map(corner).collect());
        }
        Ok(Vec::new())
    }

    /// The tags of the grid that OpenCV finds; none that is there twice.
    fn tags(&self, image: &Mat, dictionary: &Ptr<Dictionary>, border: i32) -> Result<BTreeMap<usize, Tag>> {
        let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
        let mut parameters = DetectorParameters::create()?;
        parameters.set_marker_border_bits(border);
        parameters.set_adaptive_thresh_win_size_max(33);
        parameters.set_adaptive_thresh_win_size_step(6);
        parameters.set_min_marker_perimeter_rate(0.02);
        detect_markers(image, dictionary, &mut corners, &mut ids, &parameters, &mut no_array())?;
        let mut tags = BTreeMap::new();
        let mut twice = Vec::new();
        for (quad, id) in corners.iter().zip(ids.iter()) {
            let Some(id) = usize::try_from(id).ok().filter(|id| *id < self.columns * self.rows) else {
                continue;
            };
            let quad: Vec<Vector2<f64>> = quad.iter().map(|point| vector(&point)).collect();
            if quad.len() == 4 && tags.insert(id, ORDER.map(|k| quad[k])).is_some() {
                twice.push(id);
            }
        }
        for id in twice {
            tags.remove(&id);
        }
        Ok(tags)
    }

    /// Adds the tags that their neighbours lead to.
    fn complete(
        &self,
        image: &GrayImage,
        pixels: &Mat,
        dictionary: &Ptr<Dictionary>,
        border: i32,
        tags: &mut BTreeMap<usize, Tag>,
    ) -> Result<()> {
        let mut grown = true;
        while grown {
            grown = false;
            for id in 0..self.columns * self.rows {
                if tags.contains_key(&id) {
                    continue;
                }
                let Some(rough) = self.predicted(id, tags) else { continue };
                let inside = |corner: &Vector2<f64>| image.contains(corner.x as f32, corner.y as f32, 6.0);
                if side(&rough) < MIN_SIDE || !rough.iter().all(inside) {
                    continue;
                }
                let Some(tag) = refined_tag(pixels, &rough, 0.1)? else { continue };
                if tag.iter().all(inside)
                    && wrong_bits(image, dictionary, border, id, &tag)? <= MAX_WRONG_BITS
                {
                    tags.insert(id, tag);
                    grown = true;
                }
            }
        }
        Ok(())
    }

    /// Where a tag must be by those nearest to it.
    fn predicted(&self, id: usize, tags: &BTreeMap<usize, Tag>) -> Option<Tag> {
        let place = |id: usize| ((id % self.columns) as i64, (id / self.columns) as i64);
        let (x, y) = place(id);
        let offset = |other: usize| (place(other).0 - x, place(other).1 - y);
        let near = tags.keys().copied().filter(|&other| {
            let (dx, dy) = offset(other);
            dx.abs() <= 2 && dy.abs() <= 2
        });
        let mut near: Vec<usize> = near.collect();
        near.sort_by_key(|&other| {
            let (dx, dy) = offset(other);
            (dx * dx + dy * dy, other)
        });
        near.truncate(NEIGHBOURS);
        if near.len() < 2 {
            return None;
        }
        let pairs: Vec<_> =
            near.iter().flat_map(|&id| (0..4).map(move |k| (self.point(id, k), tags[&id][k]))).collect();
        let homography = homography(&pairs)?;
        Some(std::array::from_fn(|k| mapped(&homography, &self.point(id, k))))
    }

    fn point(&self, id: usize, corner: usize) -> Vector2<f64> {
        self.points[4 * id + corner].xy()
    }

    /// Whether these corners lie as on the grid, and if not, how instead; for people.
    pub fn wrong_order(&self, corners: &[Corner]) -> Option<&'static str> {
        let (columns, rows) = (self.columns, self.rows);
        let orders: [(&str, &dyn Fn(usize) -> usize); 3] = [
            ("from right to left: the grid is mirrored", &|id| {
                id / columns * columns + columns - 1 - id % columns
            }),
            ("from the top row down: the grid is mirrored, or from another program than Kalibr", &|id| {
                (rows - 1 - id / columns) * columns + id % columns
            }),
            ("from the other end", &|id| columns * rows - 1 - id),
        ];
        let bend = |order: &dyn Fn(usize) -> usize| {
            let middle = |id: usize| (self.point(id, 0) + self.point(id, 2)) * 0.5;
            let mut tags: BTreeMap<usize, Vec<Vector2<f64>>> = BTreeMap::new();
            corners.iter().for_each(|corner| tags.entry(corner.index / 4).or_default().push(corner.pixel));
            let whole = tags.iter().filter(|(_, tag)| tag.len() == 4);
            let pairs: Vec<_> = whole
                .map(|(id, tag)| (middle(order(*id)), tag.iter().sum::<Vector2<f64>>() / 4.0, tag))
                .collect();
            let homography = homography(&pairs.iter().map(|(a, b, _)| (*a, *b)).collect::<Vec<_>>())?;
            let off = |(a, b, tag): &(Vector2<f64>, Vector2<f64>, &Vec<Vector2<f64>>)| {
                (mapped(&homography, a) - b).norm() / (tag[0] - tag[1]).norm()
            };
            Some(pairs.iter().map(off).sum::<f64>() / pairs.len() as f64)
        };
        let own = bend(&|id| id)?;
        // Mirrored about an axis alone, the middles fit as well: then the corners of each tag do not.
        if own < MAX_BEND && self.corners_fit(corners) {
            return None;
        }
        let fits = |order: &dyn Fn(usize) -> usize| bend(order).is_some_and(|bend| bend < MAX_BEND);
        Some(orders.iter().find(|(_, order)| fits(order)).map_or("in no known order", |(name, _)| name))
    }

    /// Whether all corners fit one homography to half of a tag's side.
    fn corners_fit(&self, corners: &[Corner]) -> bool {
        let pairs: Vec<_> = corners.iter().map(|c| (self.points[c.index].xy(), c.pixel)).collect();
        let Some(h) = homography(&pairs) else { return true };
        let tag = (self.point(0, 1) - self.point(0, 0)).norm();
        let off = |(a, b): &(Vector2<f64>, Vector2<f64>)| {
            let one = (mapped(&h, &(a + Vector2::new(tag, 0.0))) - mapped(&h, a)).norm();
            (mapped(&h, a) - b).norm() / one.max(1.0)
        };
        pairs.iter().map(off).sum::<f64>() / (pairs.len() as f64) < MAX_BEND
    }

    pub fn what_else(&self, images: &[GrayImage]) -> Result<String> {
        let dictionary = get_predefined_dictionary_i32(DICT_APRILTAG_36h11)?;
        for image in images {
            let pixels = mat(&mirrored(image))?;
            for border in [2, 1] {
                if self.tags(&pixels, &dictionary, border)?.len() >= 3 {
                    return Ok("but they are there in the mirrored image\nhint: the images are mirrored (or the board was \
                               printed so): switch mirroring off in the camera"
                        .into());
                }
            }
        }
        Ok(format!(
            "no tag 36h11 with a number below {}\nhint: check the tags' family and that the board is large and sharp in the \
             images",
            self.columns * self.rows
        ))
    }
}

fn side(tag: &Tag) -> f64 {
    (0..4).map(|k| (tag[k] - tag[(k + 1) % 4]).norm()).fold(f64::INFINITY, f64::min)
}

/// The tag's corners to a fraction of a pixel; `None` when one moves by more than `reach` of the tag's side.
fn refined_tag(image: &Mat, rough: &Tag, reach: f64) -> Result<Option<Tag>> {
    let side = side(rough);
    let radius = (WINDOW * side).round().clamp(2.0, 6.0) as i32;
    let fine = refined(image, rough, radius)?;
    let moved = rough.iter().zip(&fine).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    let tag = <Tag>::try_from(fine).ok();
    Ok(tag.filter(|_| moved <= reach * side + 1.0))
}

/// How many of its bits are not those of the tag of this number.
fn wrong_bits(
    image: &GrayImage,
    dictionary: &Ptr<Dictionary>,
    border: i32,
    id: usize,
    tag: &Tag,
) -> Result<i32> {
    const BITS: usize = 6;
    let border = border as usize;
    let cells = BITS + 2 * border;
    let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vector2::new(x, y));
    // OpenCV's order again, as its bits are.
    let pairs: Vec<_> = (0..4).map(|k| (unit[k], tag[ORDER[k]])).collect();
    let Some(homography) = homography(&pairs) else { return Ok(i32::MAX) };
    let level = |column: usize, row: usize| cell_level(image, &homography, column, row, cells);
    let (mut dark, mut count, mut brightest) = (0.0, 0.0, 0.0f32);
    let mut levels = vec![0.0f32; cells * cells];
    for row in 0..cells {
        for column in 0..cells {
            let value = level(column, row);
            levels[row * cells + column] = value;
            let within = |at: usize| at >= border && at < border + BITS;
            if within(row) && within(column) {
                brightest = brightest.max(value);
            } else {
                (dark, count) = (dark + value, count + 1.0);
            }
        }
    }
    let threshold = 0.5 * (dark / count + brightest);
    let bit = |i: usize| {
        let (row, column) = (i / BITS + border, i % BITS + border);
        u8::from(levels[row * cells + column] > threshold)
    };
    let bits: Vec<u8> = (0..BITS * BITS).map(bit).collect();
    let bits = Mat::from_slice(&bits)?;
    let bits = bits.reshape(1, BITS as i32)?;
    Ok(dictionary.get_distance_to_id(&bits, id as i32, true)?)
}

/// Mean of a few places in the middle of a cell.
fn cell_level(image: &GrayImage, homography: &Matrix3<f64>, column: usize, row: usize, cells: usize) -> f32 {
    let places = [0.35, 0.5, 0.65];
    let mut sum = 0.0;
    for dy in places {
        for dx in places {
            let at = Vector2::new((column as f64 + dx) / cells as f64, (row as f64 + dy) / cells as f64);
            let pixel = mapped(homography, &at).cast::<f32>();
            sum += if image.contains(pixel.x, pixel.y, 0.0) { image.bilinear(pixel.x, pixel.y) } else { 0.0 };
        }
    }
    sum / (places.len() * places.len()) as f32
}
