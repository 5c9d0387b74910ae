//! Cells that hang together, as pieces.

use super::PlaceParams;
use backend::verdict::{Piece, PieceKind};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// What two keyframes saw of a cell of surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Its middle in one world.
    pub position: Vector3<f64>,
    /// Its width there.
    pub width: f64,
    /// Standard deviation of its band over the mean intensity.
    pub contrast: f64,
    /// 0 for an edge to 1 for grain.
    pub roundness: f64,
    /// `ln p(what both saw | one surface) − ln p(… | unrelated)`.
    pub ln_agreement: f64,
}

type Key = [i64; 3];

/// What all keyframes together saw of the surface in a cube.
#[derive(Clone, Copy, Debug, Default)]
struct Cube {
    count: f64,
    contrast: f64,
    roundness: f64,
    ln_agreement: f64,
}

/// The pieces that cells make: those in one cube are one, seen several times; cubes that touch and say the same of the same kind of
/// look are one piece.
pub(super) fn pieces(spots: &[Spot], params: &PlaceParams) -> Vec<Piece> {
    let mut widths: Vec<f64> = spots.iter().map(|spot| spot.width).collect();
    widths.sort_by(f64::total_cmp);
    let Some(&side) = widths.get(widths.len() / 2).filter(|side| **side > 0.0) else { return Vec::new() };
    let mut cubes: BTreeMap<Key, Cube> = BTreeMap::new();
    for spot in spots {
        let key = [0, 1, 2].map(|axis| (spot.position[axis] / side).floor() as i64);
        let cube = cubes.entry(key).or_default();
        cube.count += 1.0;
        cube.contrast += spot.contrast;
        cube.roundness += spot.roundness;
        cube.ln_agreement += spot.ln_agreement;
    }
    for cube in cubes.values_mut() {
        cube.contrast /= cube.count;
        cube.roundness /= cube.count;
        cube.ln_agreement /= cube.count;
    }
    let kind = |cube: &Cube| {
        let is_wear =
            cube.contrast <= params.max_wear_contrast && cube.roundness >= params.min_wear_roundness;
        if is_wear { PieceKind::Wear } else { PieceKind::Look }
    };
    let class = |cube: &Cube| (kind(cube), cube.ln_agreement > 0.0);
    let mut left = cubes.clone();
    let all = cubes.len() as f64;
    let mut pieces = Vec::new();
    while let Some((key, first)) = left.pop_first() {
        let (mut area, mut next) = (vec![first], vec![key]);
        while let Some(key) = next.pop() {
            for around in around(key) {
                if left.get(&around).is_some_and(|cube| class(cube) == class(&first)) {
                    area.extend(left.remove(&around));
                    next.push(around);
                }
            }
        }
        pieces.push(piece(&area, kind(&first), all, params));
    }
    pieces
}

fn piece(area: &[Cube], kind: PieceKind, all: f64, params: &PlaceParams) -> Piece {
    let count = area.len() as f64;
    let mean = area.iter().map(|cube| cube.ln_agreement).sum::<f64>() / count;
    // Of one thing its cells say the same together; a larger piece is so many things.
    let of_thing = count.min(params.cells_of_thing);
    let things = (count / params.cells_of_thing).max(if mean < 0.0 { 1.0 } else { 0.0 });
    Piece { kind, share: count / all, things, occurrences: 1.0, ln_agreement: mean * of_thing }
}

/// The 26 cubes around one.
fn around([x, y, z]: Key) -> impl Iterator<Item = Key> {
    let offsets = (0..27).filter(|i| *i != 13).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    offsets.map(move |[dx, dy, dz]| [x + dx, y + dy, z + dz])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(x: f64, contrast: f64, ln_agreement: f64) -> Spot {
        Spot { position: Vector3::new(x + 0.5, 0.5, 0.5), width: 1.0, contrast, roundness: 0.7, ln_agreement }
    }

    #[test]
    fn cells_that_hang_together_are_one_piece_however_often_seen() {
        let params = PlaceParams::default();
        let alike = (0..8).map(|x| spot(f64::from(x), 0.2, 2.0));
        let other = (8..10).map(|x| spot(f64::from(x), 0.2, -3.0));
        let apart = std::iter::once(spot(20.0, 0.2, 2.0));
        let spots: Vec<Spot> = alike.chain(other).chain(apart).collect();
        let found = pieces(&spots, &params);
        let says = |found: &[Piece]| {
            found.iter().map(|piece| (piece.things, piece.ln_agreement)).collect::<Vec<_>>()
        };
        assert_eq!(says(&found), [(2.0, 8.0), (1.0, -6.0), (0.25, 2.0)]);
        assert_eq!(says(&pieces(&spots.repeat(3), &params)), says(&found));
        assert!(pieces(&[], &params).is_empty());
    }
}
