//! Kalibr's grids of AprilTags.
//!
//! Tags are found by their corners where black squares between them touch these, as on Kalibr's grids, and by their dark
//! outlines where none do, as of a tag alone. The others follow from those: where a tag must be, by its neighbours, its
//! corners are looked for and its bits are read.

use super::sub_pixel::refined;
use super::tag::{Bits, MAX_WRONG_BITS, Tag, Tags, border_share, side};
use super::{mirrored, tag_seeds};
use anyhow::{Context, Result, bail};
use calib::planar::{homography, mapped};
use calib::{Board, Corner};
use geometry::GrayImage;
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;

/// Corners in the order of [`Board::points`] of a tag's corners from that of its first bit on, clockwise: Kalibr's tags stand
/// on their heads.
pub const ORDER: [usize; 4] = [1, 0, 3, 2];
/// Part of the width of a tag's border, and of half of the gap to the next tag, that is looked at around a corner: beyond them
/// other corners begin.
const OF_BORDER: f64 = 0.8;
const OF_HALF_GAP: f64 = 1.07;
/// Tags are not looked for below this side, pixels.
const MIN_SIDE: f64 = 10.0;
/// Neighbouring tags that say where another one must be.
const NEIGHBOURS: usize = 5;
/// Most share of a tag's side that corners may be off a homography of the whole grid; lenses bend it.
const MAX_BEND: f64 = 0.5;
/// How far the corners of a tag may be from where they are first thought to be, as a share of its side.
const SEED_REACH: f64 = 0.15;
const NEIGHBOUR_REACH: f64 = 0.1;
/// Widths of a tag's black border in bits: Kalibr's, and that of others.
pub const BORDERS: [usize; 2] = [2, 1];

/// A grid of tags 36h11.
pub struct AprilGrid {
    columns: usize,
    rows: usize,
    points: Vec<Vector3<f64>>,
    /// Gap between tags as a share of the side of a tag.
    spacing: f64,
    tags: Tags,
}

impl AprilGrid {
    /// A detector of this board.
    ///
    /// # Errors
    /// When there are fewer tags than the board has.
    pub fn new(board: &Board, columns: usize, rows: usize) -> Result<Self> {
        let tags = Tags::april_36h11(columns * rows)
            .with_context(|| format!("--board {board}: there are not so many tags 36h11"))?;
        let Board::AprilGrid { spacing, .. } = *board else { bail!("{board} is no AprilGrid") };
        Ok(Self { columns, rows, points: board.points(), spacing, tags })
    }

    /// The corners of all tags that are seen.
    pub fn corners(&self, image: &GrayImage) -> Vec<Corner> {
        let found =
            BORDERS.into_iter().map(|border| self.completed(image, border, self.seeds(image, border)));
        found.into_iter().find(|corners| !corners.is_empty()).unwrap_or_default()
    }

    /// The corners of the tags whose corners are nearly at `seeds`, and of those that these lead to.
    pub fn completed(&self, image: &GrayImage, border: usize, seeds: BTreeMap<usize, Tag>) -> Vec<Corner> {
        let fine = seeds
            .into_iter()
            .filter_map(|(id, rough)| Some((id, self.refined(image, border, &rough, SEED_REACH)?)));
        let mut tags: BTreeMap<usize, Tag> = fine.collect();
        if tags.is_empty() {
            return Vec::new();
        }
        self.complete(image, border, &mut tags);
        let corner =
            |(id, tag): (usize, Tag)| (0..4).map(move |k| Corner { index: 4 * id + k, pixel: tag[k] });
        tags.into_iter().flat_map(corner).collect()
    }

    /// Number of tags.
    #[cfg(feature = "opencv")]
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// The tags of the grid that are seen without regard to their neighbours; none that is there twice.
    fn seeds(&self, image: &GrayImage, border: usize) -> BTreeMap<usize, Tag> {
        let seen = |quads: Vec<Tag>| -> BTreeMap<usize, Tag> {
            let mut tags: BTreeMap<usize, (u32, Tag)> = BTreeMap::new();
            let mut twice = Vec::new();
            for quad in quads {
                let Some(bits) = Bits::read(image, &quad, border) else { continue };
                let Some((id, turns)) = self.tags.find(&bits) else { continue };
                let tag: Tag = ORDER.map(|k| quad[(k + turns) % 4]);
                let wrong = self.tags.wrong_cells(id, turns, &bits);
                match tags.get(&id) {
                    Some((_, other)) if (other[0] - tag[0]).norm() > 0.5 * side(&tag) => twice.push(id),
                    // Corners of other squares beside a tag's own: fewer of its cells are then as they must be.
                    Some((best, _)) if *best <= wrong => {}
                    _ => drop(tags.insert(id, (wrong, tag))),
                }
            }
            tags.retain(|id, _| !twice.contains(id));
            tags.into_iter().map(|(id, (_, tag))| (id, tag)).collect()
        };
        let by_corners = seen(tag_seeds::between_corners(image));
        if by_corners.is_empty() { seen(tag_seeds::dark_outlines(image)) } else { by_corners }
    }

    /// Adds the tags that their neighbours lead to.
    fn complete(&self, image: &GrayImage, border: usize, tags: &mut BTreeMap<usize, Tag>) {
        let inside = |corner: &Vector2<f64>| image.contains(corner.x as f32, corner.y as f32, 6.0);
        let mut grown = true;
        while grown {
            grown = false;
            for id in 0..self.columns * self.rows {
                if tags.contains_key(&id) {
                    continue;
                }
                let Some(rough) = self.predicted(id, tags) else { continue };
                if side(&rough) < MIN_SIDE || !rough.iter().all(inside) {
                    continue;
                }
                let Some(tag) = self.refined(image, border, &rough, NEIGHBOUR_REACH) else { continue };
                // The inverse of the order is the order itself.
                let bits = Bits::read(image, &ORDER.map(|k| tag[k]), border);
                if tag.iter().all(inside)
                    && bits.is_some_and(|bits| self.tags.wrong_bits(id, &bits) <= MAX_WRONG_BITS)
                {
                    tags.insert(id, tag);
                    grown = true;
                }
            }
        }
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

    /// The tag's corners to a fraction of a pixel; `None` when one moves by more than `reach` of the tag's side.
    fn refined(&self, image: &GrayImage, border: usize, rough: &Tag, reach: f64) -> Option<Tag> {
        let side = side(rough);
        let window = (OF_BORDER * border_share(border)).min(OF_HALF_GAP * self.spacing / 2.0);
        let radius = (window * side).round().clamp(2.0, 6.0) as usize;
        let fine = refined(image, rough, radius);
        let moved = rough.iter().zip(&fine).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        <Tag>::try_from(fine).ok().filter(|_| moved <= reach * side + 1.0)
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

    /// What these images show instead, for people.
    pub fn what_else(&self, images: &[GrayImage]) -> String {
        for image in images {
            let mirrored = mirrored(image);
            if BORDERS.into_iter().any(|border| self.seeds(&mirrored, border).len() >= 3) {
                return "but they are there in the mirrored image\nhint: the images are mirrored (or the board was printed so): \
                        switch mirroring off in the camera"
                    .into();
            }
        }
        format!(
            "no tag 36h11 with a number below {}\nhint: check the tags' family and that the board is large and sharp in the \
             images",
            self.columns * self.rows
        )
    }
}
