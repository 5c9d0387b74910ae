//! Squares in an image that may be tags.

use super::tag::{Tag, side};
use super::view;
use calib_targets_chessboard::{ChessCorner, default_chess_config, detect_corners};
use geometry::GrayImage;
use nalgebra::Vector2;

/// Corners that are looked at: an image full of texture has thousands.
const MAX_CORNERS: usize = 1500;
/// Corners around one that may be its tag's next ones: on Kalibr's grid the next tag's are nearer.
const AROUND: usize = 24;
/// How far a side's direction may be from that of the edges at its corner, radians: lenses bend, edges are measured nearby.
const MAX_BEND: f64 = 0.25;
/// Most ratio of two sides of a tag that is seen at a slant.
const MAX_RATIO: f64 = 2.5;
/// How far the fourth corner may be from where the other three say, as a share of the side.
const MAX_SKEW: f64 = 0.35;
/// Least side of a tag, pixels.
const MIN_SIDE: f64 = 10.0;

/// Squares between corners where black and white cross, as at the tags of Kalibr's grids: clockwise, from any corner.
pub fn between_corners(image: &GrayImage) -> Vec<Tag> {
    let mut corners = detect_corners(&view(image), &default_chess_config());
    corners.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    corners.truncate(MAX_CORNERS);
    let places: Vec<Vector2<f64>> = corners.iter().map(place).collect();
    let mut quads = Vec::new();
    for (corner, at) in corners.iter().zip(&places) {
        let sides = along_edges(corner, &nearest(&places, at));
        for b in &sides {
            for d in &sides {
                let (ab, ad) = (b - at, d - at);
                let ratio = ab.norm() / ad.norm();
                // Clockwise, as rows run downwards; from its first corner only, which lies highest.
                let is_first = at.y <= b.y.min(d.y);
                if !is_first
                    || ab.perp(&ad) <= 0.3 * ab.norm() * ad.norm()
                    || !(1.0 / MAX_RATIO..MAX_RATIO).contains(&ratio)
                {
                    continue;
                }
                let (c, off) = closest(&places, &(b + ad));
                if off < MAX_SKEW * ab.norm().min(ad.norm()) {
                    quads.push([*at, *b, c, *d]);
                }
            }
        }
    }
    quads.retain(|quad| side(quad) >= MIN_SIDE);
    quads
}

fn place(corner: &ChessCorner) -> Vector2<f64> {
    Vector2::new(f64::from(corner.position.x), f64::from(corner.position.y))
}

/// Those of `others` that lie in the direction of one of the edges that cross at the corner.
fn along_edges(corner: &ChessCorner, others: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let at = place(corner);
    let along = |other: &&Vector2<f64>| {
        let path = *other - at;
        corner.axes.iter().any(|axis| {
            let (sin, cos) = f64::from(axis.angle).sin_cos();
            path.perp(&Vector2::new(cos, sin)).abs() < MAX_BEND.sin() * path.norm()
        })
    };
    others.iter().filter(along).copied().collect()
}

/// The corners nearest to one, without it.
fn nearest(places: &[Vector2<f64>], at: &Vector2<f64>) -> Vec<Vector2<f64>> {
    let mut others: Vec<(f64, Vector2<f64>)> = places
        .iter()
        .map(|other| ((other - at).norm_squared(), *other))
        .filter(|(apart, _)| *apart > 0.0)
        .collect();
    if others.len() > AROUND {
        others.select_nth_unstable_by(AROUND, |a, b| a.0.total_cmp(&b.0));
        others.truncate(AROUND);
    }
    others.into_iter().map(|(_, other)| other).collect()
}

/// The corner closest to a place, and how far it is from there.
fn closest(places: &[Vector2<f64>], to: &Vector2<f64>) -> (Vector2<f64>, f64) {
    let apart = |place: &Vector2<f64>| (place - to).norm();
    let best = places.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).copied();
    best.map_or((*to, f64::INFINITY), |place| (place, apart(&place)))
}

/// How much darker than its surroundings a pixel of a tag's border is at the least, grey levels.
const DARKER: f64 = 7.0;
/// Sides of the surroundings as parts of the image's shorter side: of small tags and of large ones.
const SURROUNDINGS: [usize; 2] = [24, 6];
/// Least share of its outline's area that the square through its four corners has.
const MIN_FILLED: f64 = 0.9;

/// Squares with a dark outline on a lighter ground: clockwise, from any corner.
pub fn dark_outlines(image: &GrayImage) -> Vec<Tag> {
    let shorter = image.width().min(image.height());
    let masks = SURROUNDINGS.map(|part| dark(image, (shorter / part).max(5)));
    let outlines = masks.into_iter().flat_map(|mask| outlines(mask, image.width()));
    outlines.filter_map(|points| square(&hull(points))).filter(|quad| side(quad) >= MIN_SIDE).collect()
}

/// Which pixels are darker than the mean of the square of `2 · reach + 1` pixels around them.
fn dark(image: &GrayImage, reach: usize) -> Vec<bool> {
    let (width, height) = (image.width(), image.height());
    let mut sums = vec![0u64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0;
        for x in 0..width {
            row += u64::from(image.get(x, y));
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let is_dark = |i: usize| {
        let (x, y) = (i % width, i / width);
        let (left, top) = (x.saturating_sub(reach), y.saturating_sub(reach));
        let (right, bottom) = ((x + reach + 1).min(width), (y + reach + 1).min(height));
        let sum = |x: usize, y: usize| sums[y * (width + 1) + x];
        let total = sum(right, bottom) + sum(left, top) - sum(left, bottom) - sum(right, top);
        let mean = total as f64 / ((right - left) * (bottom - top)) as f64;
        f64::from(image.get(x, y)) < mean - DARKER
    };
    (0..width * height).map(is_dark).collect()
}

/// Of each patch of dark pixels that hang together and do not touch the image's border, the first and last pixel of its rows.
fn outlines(mut mask: Vec<bool>, width: usize) -> Vec<Vec<Vector2<f64>>> {
    let height = mask.len() / width.max(1);
    let mut all = Vec::new();
    for start in 0..mask.len() {
        if !std::mem::take(&mut mask[start]) {
            continue;
        }
        let (mut open, mut patch, mut cut) = (vec![start], Vec::new(), false);
        while let Some(i) = open.pop() {
            patch.push((i / width, i % width));
            let (x, y) = (i % width, i / width);
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                cut = true;
                continue;
            }
            for next in [i - 1, i + 1, i - width, i + width] {
                if std::mem::take(&mut mask[next]) {
                    open.push(next);
                }
            }
        }
        if cut || (patch.len() as f64) < MIN_SIDE * MIN_SIDE / 2.0 {
            continue;
        }
        patch.sort_unstable();
        let ends = patch.chunk_by(|a, b| a.0 == b.0).flat_map(|row| [row[0], row[row.len() - 1]]);
        all.push(ends.map(|(y, x)| Vector2::new(x as f64, y as f64)).collect());
    }
    all
}

/// The convex hull of points in the order of their rows, clockwise (Andrew's chains).
fn hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut hull: Vec<Vector2<f64>> = Vec::new();
    for pass in 0..2 {
        let begin = hull.len();
        for point in &points {
            while hull.len() >= begin + 2 {
                let (a, b) = (hull[hull.len() - 2], hull[hull.len() - 1]);
                if (b - a).perp(&(point - b)) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(*point);
        }
        hull.pop();
        if pass == 0 {
            points.reverse();
        }
    }
    hull
}

/// The square that a convex outline is, clockwise: the two corners farthest from each other and the two farthest from the line
/// through them; `None` where it fills too little of the outline.
fn square(hull: &[Vector2<f64>]) -> Option<Tag> {
    let pairs = hull.iter().enumerate().flat_map(|(i, a)| hull[i + 1..].iter().map(move |c| (*a, *c)));
    let (a, c) = pairs.max_by(|(a, b), (c, d)| (a - b).norm_squared().total_cmp(&(c - d).norm_squared()))?;
    let neighbour = |point: &&Vector2<f64>| (c - a).perp(&(*point - a));
    let left = hull.iter().min_by(|p, q| neighbour(p).total_cmp(&neighbour(q)))?;
    let right = hull.iter().max_by(|p, q| neighbour(p).total_cmp(&neighbour(q)))?;
    let quad = [a, *left, c, *right];
    (area(&quad) > 0.0 && area(&quad) >= MIN_FILLED * area(hull)).then_some(quad)
}

/// The area of a polygon, positive where its corners run clockwise in an image.
fn area(polygon: &[Vector2<f64>]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    0.5 * polygon.iter().zip(next).map(|(a, b)| a.perp(b)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(points: &[(f64, f64)]) -> Vec<Vector2<f64>> {
        points.iter().map(|(x, y)| Vector2::new(*x, *y)).collect()
    }

    #[test]
    fn a_slanted_outline_is_a_square_and_a_round_one_is_not() {
        let corners = points(&[(10.0, 4.0), (50.0, 10.0), (44.0, 52.0), (6.0, 40.0)]);
        let along = |i: usize| (0..20).map(move |k| (i, f64::from(k) / 20.0));
        let outline =
            (0..4).flat_map(along).map(|(i, t)| corners[i] * (1.0 - t) + corners[(i + 1) % 4] * t).collect();
        let quad = square(&hull(outline)).expect("a square");
        for corner in &corners {
            assert!(quad.iter().any(|found| (found - corner).norm() < 1e-9), "{corner} in {quad:?}");
        }
        assert!(area(&quad) > 0.0);
        let round = (0..60).map(|i| {
            let (sin, cos) = (f64::from(i) * 0.1047).sin_cos();
            Vector2::new(30.0 + 20.0 * cos, 30.0 + 20.0 * sin)
        });
        assert!(square(&hull(round.collect())).is_none());
    }

    #[test]
    fn a_dark_square_is_found_and_one_at_the_images_border_is_not() {
        let mut image = GrayImage::filled(120, 100, 0);
        image.data_mut().fill(200);
        let mut paint = |x0: usize, y0: usize| {
            (y0..y0 + 30).for_each(|y| (x0..x0 + 30).for_each(|x| image.set(x, y, 20)));
        };
        paint(40, 30);
        paint(90, 60);
        let quads = dark_outlines(&image);
        assert!(!quads.is_empty());
        for quad in quads {
            assert!(
                quad.iter()
                    .all(|corner| (38.0..72.0).contains(&corner.x) && (28.0..62.0).contains(&corner.y)),
                "{quad:?}"
            );
        }
    }
}
