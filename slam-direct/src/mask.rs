//! Masks parts of the image that move with the camera: a bonnet, a burnt-in clock, black bars, the border that
//! rectification leaves, dirt on the lens. In every frame their edges all agree that the camera stands still, so they
//! outvote a world whose points come and go.
//!
//! Such edges stay at their pixels, in the same direction, while the other edges around them come and go, and
//! although the camera rotates in a way that moves all edges of their direction. Without a rotation they look like
//! distant things. Edges next to black that reaches the border of the image need no such rotation: many edges of few
//! directions, they can hide it.

use crate::depth::doubled_gradient;
use geometry::{GrayImage, Image, Pinhole, Pyramid};
use nalgebra::UnitQuaternion;
use std::sync::Arc;

/// Least difference of grey levels over two pixels of an edge.
const STRONG: i32 = 12;
/// Cosine of the angle up to which two gradients are of one direction: a seventh of all directions, so that edges of the world
/// agree so often by chance.
const SAME_DIRECTION: f32 = 0.9;
/// Columns and rows of the parts that an image is divided into to tell whether the camera has moved. Who passes a camera that
/// stands moves in some of them.
const PARTS: (usize, usize) = (8, 6);
/// Share of a part's edges that may be where they were when it counts as another view.
const STAYING: f32 = 0.5;
/// Share of the parts that are other views when the camera has moved.
const MOVED: f32 = 0.5;
/// Frames in which an edge must have been seen as before, and how many times fewer may show another one: by chance one of
/// 10⁶ edges is.
const SEEN: u8 = 8;
const RARELY: u8 = 8;
/// Frames of them in which the camera had turned so that an edge far away would have left, by so many pixels across.
const TURNED: u8 = 3;
const LEFT: f32 = 2.0;
/// Grey levels that are black: what video codes as such.
const BLACK: u8 = 16;
/// Frames that count; what was before fades.
const MEMORY: u8 = 24;
/// Such edges among the nine pixels of a neighbourhood: they hang together.
const TOGETHER: usize = 4;
/// Pixels from one edge to the next that hangs together with it, in each direction.
const LINKED: usize = 2;
/// Pixels around such an edge in which the world has to move, in each direction: what is far ahead stays too, all of it.
const AROUND: usize = 6;
/// Edges of the world that are asked for there, at the least.
const ASKED: usize = 8;
/// Share of an image's edges that has to be fixed to the camera to be told. Fewer are outvoted by the world.
const LEAST: f32 = 0.005;
/// Share of an image's edges that can be fixed to the camera. Of more it is likelier that the camera stands and all that
/// moves is before it.
const MOST: f32 = 0.5;
/// Pixels of the pyramid's level that is looked at, at the most: edges are sought as in 400 × 300 pixels whatever the camera.
const PIXELS: usize = 160_000;
/// Every so many frames are looked at when the first are over.
const LATER: usize = 4;
/// Every so many edges are asked whether the camera has moved.
const EVERY: usize = 4;

/// How much of the images an agent does not use: shares of their pixels, none of which is counted twice.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeftOut {
    /// By the mask that it was given.
    pub given: f64,
    /// Because it was found to move with the camera.
    pub found: f64,
}

/// The pixels of an image that do not show the world.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mask {
    /// What somebody said is not to be used, pixel by pixel.
    given: Option<Arc<Image<bool>>>,
    /// Level of the pyramid whose pixels these are, and their number in a row.
    level: usize,
    width: usize,
    covered: Vec<bool>,
}

impl Mask {
    /// Whether the pixel is covered.
    pub fn covers(&self, x: usize, y: usize) -> bool {
        // Most images have none.
        !self.is_empty() && (self.is_given(x, y) || self.is_found(x, y))
    }

    fn is_given(&self, x: usize, y: usize) -> bool {
        self.given.as_ref().is_some_and(|given| x < given.width() && y < given.height() && given.get(x, y))
    }

    fn is_found(&self, x: usize, y: usize) -> bool {
        let (x, y) = (x >> self.level, y >> self.level);
        x < self.width && self.covered.get(y * self.width + x).is_some_and(|covered| *covered)
    }

    /// How much it covers of an image of this size.
    fn share_of(&self, width: usize, height: usize) -> LeftOut {
        let mut counts = [0_usize; 2];
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let is_given = self.is_given(x, y);
            counts[0] += usize::from(is_given);
            counts[1] += usize::from(!is_given && self.is_found(x, y));
        }
        let [given, found] = counts.map(|count| count as f64 / (width * height).max(1) as f64);
        LeftOut { given, found }
    }

    /// The same of a position.
    pub fn covers_at(&self, [x, y]: [f32; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && self.covers(x as usize, y as usize)
    }

    /// Whether it covers nothing.
    pub fn is_empty(&self) -> bool {
        self.given.is_none() && self.covered.is_empty()
    }
}

/// An edge of an image: its pixel and its gradient, over two pixels.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: u32,
    gradient: (i32, i32),
}

/// What is known of a pixel's edges.
#[derive(Clone, Copy, Debug, Default)]
struct PixelEdges {
    /// Mean direction; zero before there was one.
    direction: [f32; 2],
    /// Frames that showed an edge of this direction, and of another one.
    same: u8,
    other: u8,
    /// Of the former, those of a camera that had turned across it.
    turned: u8,
}

impl PixelEdges {
    /// Takes an edge in; `shift` is how far the turn since the frame before moves what is far away, pixels.
    #[inline]
    fn see(&mut self, (x, y): (i32, i32), shift: [f32; 2]) {
        let (x, y) = (x as f32, y as f32);
        let norm = (x * x + y * y).sqrt();
        let (x, y) = (x / norm, y / norm);
        let [u, v] = self.direction;
        if u == 0.0 && v == 0.0 {
            self.direction = [x, y];
            return;
        }
        match x * u + y * v >= SAME_DIRECTION * (u * u + v * v).sqrt() {
            true => {
                self.same += 1;
                self.turned += u8::from((x * shift[0] + y * shift[1]).abs() >= LEFT);
            }
            false => self.other += 1,
        }
        self.direction = [0.7 * u + 0.3 * x, 0.7 * v + 0.3 * y];
        if self.same + self.other > MEMORY {
            (self.same, self.other) = (self.same / 2, self.other / 2);
            self.turned = self.turned.min(TURNED);
        }
    }

    /// Whether its edge stays.
    fn stays(&self) -> bool {
        self.same >= SEEN && self.other * RARELY <= self.same
    }
}

/// How far a turn of the camera moves what is far away in the middle of each part of the image, pixels of the level; nothing
/// where it is not known.
fn shifts(rotated_by: Option<UnitQuaternion<f64>>, camera: &Pinhole, level: usize) -> Vec<[f32; 2]> {
    let part = |part: usize| {
        let [column, row] = [part % PARTS.0, part / PARTS.0].map(|index| index as f64 + 0.5);
        let (x, y) =
            (camera.width as f64 * column / PARTS.0 as f64, camera.height as f64 * row / PARTS.1 as f64);
        let moved = camera.project(&(rotated_by? * camera.unproject(x, y)));
        Some([moved.x - x, moved.y - y].map(|shift| shift as f32 / (1 << level) as f32))
    };
    (0..PARTS.0 * PARTS.1).map(|index| part(index).unwrap_or_default()).collect()
}

/// Learns from frame to frame what moves with the camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct MaskLearner {
    known: Vec<PixelEdges>,
    /// Edges of each part of the newest frame that counted, some of them.
    edges: Vec<Vec<Edge>>,
    mask: Arc<Mask>,
    /// Pixels that were black in all frames that counted.
    black: Vec<bool>,
    /// Frames that counted.
    frames: usize,
    /// Frames that were not looked at since one was.
    passed: usize,
    /// `camera_from_world` of the newest of them; unknown where the camera was not tracked.
    rotation: Option<UnitQuaternion<f64>>,
}

impl MaskLearner {
    /// Leaves out these pixels whatever is found.
    pub fn leave_out(&mut self, given: Arc<Image<bool>>) {
        self.mask = Arc::new(Mask { given: Some(given), ..Mask::clone(&self.mask) });
    }

    /// How much of the camera's images is left out.
    pub fn left_out(&self, camera: &Pinhole) -> LeftOut {
        self.mask.share_of(camera.width, camera.height)
    }

    /// What is known so far.
    pub fn mask(&self) -> &Arc<Mask> {
        &self.mask
    }

    /// Whether so few frames counted that what moves with the camera may not be known yet.
    pub fn is_new(&self) -> bool {
        self.frames < 4 * usize::from(SEEN)
    }

    /// Goes on in another world.
    pub fn change_world(&mut self) {
        self.rotation = None;
    }

    /// Looks at a frame, if it is its turn, which the camera `camera` took in this rotation, `camera_from_world`, if it was
    /// tracked; tells whether it is now known for the first time that something moves with the camera.
    pub fn look(
        &mut self,
        pyramid: &Pyramid,
        camera: &Pinhole,
        rotation: Option<UnitQuaternion<f64>>,
    ) -> bool {
        self.passed += 1;
        if !self.is_new() && self.passed < LATER {
            return false;
        }
        self.passed = 0;
        let before = self.mask.covered.is_empty();
        let base = pyramid.base();
        let is_small = |level: &usize| (base.width() * base.height()) >> (2 * level) <= PIXELS;
        let level = (1..pyramid.len()).find(is_small).unwrap_or(pyramid.len().saturating_sub(1));
        let image = pyramid.level(level);
        if self.known.len() != image.width() * image.height() {
            let count = image.width() * image.height();
            let (known, black) = (vec![PixelEdges::default(); count], vec![true; count]);
            let mask = Arc::new(Mask { given: self.mask.given.clone(), ..Mask::default() });
            *self = Self { known, black, mask, ..Self::default() };
        }
        if self.edges.is_empty() || self.has_moved(image) {
            let since = self.rotation.zip(rotation).map(|(before, now)| now * before.inverse());
            self.add(image, level, &shifts(since, camera, level));
            self.rotation = rotation;
        }
        before && !self.mask.covered.is_empty()
    }

    /// Whether in most parts most edges are not where they were.
    fn has_moved(&self, image: &GrayImage) -> bool {
        let stays = |edge: &&Edge| {
            let (x, y) = (edge.at as usize % image.width(), edge.at as usize / image.width());
            let ((a, b), (c, d)) = (doubled_gradient(rows_around(image, y), x), edge.gradient);
            let [dot, now, then] = [a * c + b * d, a * a + b * b, c * c + d * d].map(|v| v as f32);
            dot > SAME_DIRECTION * (now * then).sqrt() && 4.0 * now >= then
        };
        let is_other =
            |part: &&Vec<Edge>| (part.iter().filter(stays).count() as f32) < STAYING * part.len() as f32;
        let others = self.edges.iter().filter(is_other).count();
        others as f32 >= MOVED * self.edges.len() as f32
    }

    /// Takes in the edges of a frame of a camera that has moved.
    fn add(&mut self, image: &GrayImage, level: usize, shifts: &[[f32; 2]]) {
        self.frames += 1;
        self.black.iter_mut().zip(image.data()).for_each(|(black, value)| *black &= *value <= BLACK);
        let (width, mut count) = (image.width(), 0);
        let (mut some, mut staying) = (vec![Vec::new(); PARTS.0 * PARTS.1], Vec::new());
        for y in 1..image.height().saturating_sub(1) {
            let rows = rows_around(image, y);
            for x in 1..width.saturating_sub(1) {
                let gradient = doubled_gradient(rows, x);
                if gradient.0 * gradient.0 + gradient.1 * gradient.1 < STRONG * STRONG {
                    continue;
                }
                // It says nothing of what moves; nor is it to be found.
                if self.mask.is_given(x << level, y << level) {
                    continue;
                }
                let at = y * width + x;
                let part = y * PARTS.1 / image.height() * PARTS.0 + x * PARTS.0 / width;
                self.known[at].see(gradient, shifts[part]);
                let known = &self.known[at];
                if known.stays() && (known.turned >= TURNED || self.is_at_border(at, image)) {
                    staying.push(at);
                } else if count % EVERY == 0 {
                    some[part].push(Edge { at: at as u32, gradient });
                }
                count += 1;
            }
        }
        some.retain(|part| !part.is_empty());
        self.edges = some;
        staying.retain(|&at| self.world_moves_around(at, width));
        let mut mask = Mask::default();
        if !staying.is_empty() && staying.len() as f32 >= LEAST * count as f32 {
            let is_staying = self.follow(&mut staying, width);
            if (staying.len() as f32) < MOST * count as f32 {
                mask = covering(&staying, &is_staying, level, width);
            }
        }
        mask.given = self.mask.given.clone();
        if self.mask.covered != mask.covered {
            self.mask = Arc::new(mask);
        }
    }

    /// Adds the edges that stay and hang together with those given: a letter has strokes that the camera has not turned
    /// across. Says of every pixel whether it is among them.
    fn follow(&self, staying: &mut Vec<usize>, width: usize) -> Vec<bool> {
        let mut is_staying = vec![false; self.known.len()];
        staying.iter().for_each(|&at| is_staying[at] = true);
        let mut next = 0;
        while let Some(&at) = staying.get(next) {
            next += 1;
            for near in square(at, width, self.known.len() / width, LINKED) {
                if !is_staying[near] && self.known[near].stays() {
                    is_staying[near] = true;
                    staying.push(near);
                }
            }
        }
        is_staying
    }

    /// Whether all is black from an edge to the border of the image.
    fn is_at_border(&self, at: usize, image: &GrayImage) -> bool {
        let (x, y) = ((at % image.width()) as i32, (at / image.width()) as i32);
        let [u, v] = self.known[at].direction;
        let (dx, dy) = if u.abs() > v.abs() { (-u.signum() as i32, 0) } else { (0, -v.signum() as i32) };
        let within = |x: i32, y: i32| {
            (0..image.width() as i32).contains(&x) && (0..image.height() as i32).contains(&y)
        };
        // The edge itself is two pixels wide.
        let ahead = (2..).map(|step| (x + step * dx, y + step * dy)).take_while(|&(x, y)| within(x, y));
        let mut ahead = ahead.map(|(x, y)| self.black[y as usize * image.width() + x as usize]);
        ahead.all(|black| black)
    }

    /// Whether the other edges around a pixel come and go.
    fn world_moves_around(&self, at: usize, width: usize) -> bool {
        let near = square(at, width, self.known.len() / width, AROUND);
        let world = near.map(|near| &self.known[near]).filter(|known| !known.stays());
        let (same, other) =
            world.fold((0, 0), |(s, o), known| (s + usize::from(known.same), o + usize::from(known.other)));
        other >= same && same + other >= ASKED
    }
}

/// The pixels that are at most so many away from one, in each direction.
fn square(at: usize, width: usize, height: usize, away: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (at % width, at / width);
    let columns = x.saturating_sub(away)..(x + away + 1).min(width);
    (y.saturating_sub(away)..(y + away + 1).min(height))
        .flat_map(move |y| columns.clone().map(move |x| y * width + x))
}

/// A row of an image that is not at the border, with those above and below.
fn rows_around(image: &GrayImage, y: usize) -> [&[u8]; 3] {
    [image.row(y - 1), image.row(y), image.row(y + 1)]
}

/// The mask of the edges `staying` that hang together, with the pixels around them.
fn covering(staying: &[usize], is_staying: &[bool], level: usize, width: usize) -> Mask {
    let around = |at: usize| square(at, width, is_staying.len() / width, 1);
    let mut covered = vec![false; is_staying.len()];
    for &at in staying {
        if around(at).filter(|&near| is_staying[near]).count() >= TOGETHER {
            around(at).for_each(|near| covered[near] = true);
        }
    }
    if covered.contains(&true) { Mask { given: None, level, width, covered } } else { Mask::default() }
}

#[cfg(test)]
mod tests;
