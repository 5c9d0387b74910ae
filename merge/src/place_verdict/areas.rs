//! Cells that hang together, as pieces.

use super::PlaceParams;
use backend::verdict::{Piece, PieceKind};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// What two keyframes saw of a cell of surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Its middle in one world.
    pub position: Vector3<f64>,
    /// Its width there.
    pub width: f64,
    /// What of it they saw.
    pub kind: PieceKind,
    /// `ln p(what both saw | one surface) − ln p(… | unrelated)`.
    pub ln_agreement: f64,
}

/// A cube, and what is looked at of the surface in it.
type Key = (PieceKind, [i64; 3]);

/// What all keyframes together saw of the surface in a cube.
#[derive(Clone, Copy, Debug, Default)]
struct Cube {
    count: f64,
    ln_agreement: f64,
}

impl Cube {
    /// Whether it agrees; nothing where it hardly speaks against one surface.
    fn agrees(&self, params: &PlaceParams) -> Option<bool> {
        let (agrees, differs) = (self.ln_agreement > 0.0, self.ln_agreement <= -params.min_difference);
        (agrees || differs).then_some(agrees)
    }
}

/// Cubes that touch, are of one kind, and all agree or all differ.
struct Area {
    agrees: bool,
    cubes: Vec<Key>,
    /// Their summed agreement.
    ln_agreement: f64,
}

/// How deep differences go that are none: what keyframes of one map miss of each other's surface, which is one.
#[derive(Clone, Debug, Default)]
pub(super) struct Noise {
    /// `−ln` of the summed agreement of each area that differs, the deepest first.
    depths: Vec<f64>,
    /// Cubes in which such areas could be.
    cubes: f64,
}

impl Noise {
    /// Of passes over one map's cells, each seen by one other keyframe, as cells are across maps.
    pub fn new(passes: &[Vec<Spot>], params: &PlaceParams) -> Self {
        let mut noise = Self::default();
        for pass in passes {
            let cubes = cubes(pass);
            noise.cubes += cubes.len() as f64;
            let areas = areas(&cubes, params).into_iter().filter(|area| !area.agrees);
            noise.depths.extend(areas.map(|area| -area.ln_agreement));
        }
        noise.depths.sort_by(|a, b| b.total_cmp(a));
        noise
    }

    /// How deep the deepest goes that is expected among so many cubes.
    fn depth(&self, cubes: usize) -> f64 {
        let rank = (self.cubes / cubes.max(1) as f64) as usize;
        self.depths.get(rank).copied().unwrap_or(0.0)
    }
}

/// The pieces that cells make: those in one cube are one, seen several times; cubes that touch and say the same of the same kind of
/// look are one piece. What differs no deeper than noise does is left out.
///
/// A thing that has changed looks otherwise and has another grain, which is one fact: grain that differs on it and next to it is
/// left out. Cubes of wear that say little each, a faint grain in noise, say it together, for or against, as one piece.
pub(super) fn pieces(spots: &[Spot], noise: &Noise, params: &PlaceParams) -> Vec<Piece> {
    let cubes = cubes(spots);
    let all = cubes.len() as f64;
    let depth = noise.depth(cubes.len());
    let (wear, looks): (BTreeMap<Key, Cube>, BTreeMap<Key, Cube>) =
        cubes.into_iter().partition(|((kind, _), _)| *kind == PieceKind::Wear);
    let looks = areas(&looks, params);
    let differing = looks.iter().filter(|area| !area.agrees && area.ln_agreement + depth < 0.0);
    let changed: BTreeSet<[i64; 3]> = differing.flat_map(|area| &area.cubes).flat_map(near).collect();
    let kept = wear.into_iter().filter(|((_, at), cube)| cube.ln_agreement >= 0.0 || !changed.contains(at));
    let is_faint = |(_, cube): &(Key, Cube)| cube.ln_agreement.abs() < params.min_difference;
    let (faint, wear): (BTreeMap<Key, Cube>, BTreeMap<Key, Cube>) = kept.partition(is_faint);
    let clear = areas(&wear, params);
    let found = looks.iter().chain(&clear).filter_map(|area| piece(area, all, depth, params));
    found.chain(together(&faint, all)).collect()
}

fn piece(area: &Area, all: f64, noise: f64, params: &PlaceParams) -> Option<Piece> {
    let (of_thing, count) = (params.cells_of_thing, area.cubes.len() as f64);
    let (kind, things) = (area.cubes[0].0, count / of_thing);
    // Of one thing its cells say the same together; a larger piece is so many things. Grain shows in a part of a thing often, and is a fact
    // whether it agrees or differs.
    let least = if area.agrees && kind != PieceKind::Wear { 0.0 } else { 1.0 };
    let ln_agreement = if area.agrees {
        area.ln_agreement * of_thing.min(count) / count
    } else {
        (area.ln_agreement + noise).min(0.0)
    };
    let things = things.max(least);
    (ln_agreement != 0.0).then_some(Piece {
        kind,
        share: count / all,
        things,
        occurrences: 1.0,
        ln_agreement,
    })
}

/// What faint wear says together.
fn together(faint: &BTreeMap<Key, Cube>, all: f64) -> Option<Piece> {
    let ln_agreement: f64 = faint.values().map(|cube| cube.ln_agreement).sum();
    let share = faint.len() as f64 / all;
    (ln_agreement != 0.0).then_some(Piece {
        kind: PieceKind::Wear,
        share,
        things: 1.0,
        occurrences: 1.0,
        ln_agreement,
    })
}

/// What is seen in each cube, of the cells' median width.
fn cubes(spots: &[Spot]) -> BTreeMap<Key, Cube> {
    let mut widths: Vec<f64> = spots.iter().map(|spot| spot.width).collect();
    widths.sort_by(f64::total_cmp);
    let mut cubes: BTreeMap<Key, Cube> = BTreeMap::new();
    let Some(&side) = widths.get(widths.len() / 2).filter(|side| **side > 0.0) else { return cubes };
    for spot in spots {
        let at = [0, 1, 2].map(|axis| (spot.position[axis] / side).floor() as i64);
        let cube = cubes.entry((spot.kind, at)).or_default();
        cube.count += 1.0;
        cube.ln_agreement += spot.ln_agreement;
    }
    for cube in cubes.values_mut() {
        cube.ln_agreement /= cube.count;
    }
    cubes
}

/// The areas that cubes make.
fn areas(cubes: &BTreeMap<Key, Cube>, params: &PlaceParams) -> Vec<Area> {
    let said = |(key, cube): (&Key, &Cube)| Some((*key, (cube.agrees(params)?, cube.ln_agreement)));
    let mut left: BTreeMap<Key, (bool, f64)> = cubes.iter().filter_map(said).collect();
    let mut areas = Vec::new();
    while let Some((key, (agrees, ln_agreement))) = left.pop_first() {
        let (mut area, mut next) = (Area { agrees, cubes: vec![key], ln_agreement }, vec![key]);
        while let Some(key) = next.pop() {
            for around in around(key) {
                if let Some((_, more)) = left.get(&around).copied().filter(|(of, _)| *of == agrees) {
                    left.remove(&around);
                    area.cubes.push(around);
                    area.ln_agreement += more;
                    next.push(around);
                }
            }
        }
        areas.push(area);
    }
    areas
}

/// The 26 cubes around one, of the same kind.
fn around(key: Key) -> impl Iterator<Item = Key> {
    near(&key).filter(move |at| *at != key.1).map(move |at| (key.0, at))
}

/// Where a cube is and the 26 around it are.
fn near((_, [x, y, z]): &Key) -> impl Iterator<Item = [i64; 3]> + use<> {
    let (x, y, z) = (*x, *y, *z);
    (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(x: f64, kind: PieceKind, ln_agreement: f64) -> Spot {
        Spot { position: Vector3::new(x + 0.5, 0.5, 0.5), width: 1.0, kind, ln_agreement }
    }

    fn row(of: std::ops::Range<usize>, ln_agreement: f64) -> Vec<Spot> {
        of.map(|x| spot(x as f64, PieceKind::Look, ln_agreement)).collect()
    }

    fn wear(x: usize, ln_agreement: f64) -> Spot {
        spot(x as f64, PieceKind::Wear, ln_agreement)
    }

    fn says(spots: &[Spot], noise: &Noise) -> Vec<(f64, f64)> {
        let pieces = pieces(spots, noise, &PlaceParams::default());
        pieces.iter().map(|piece| (piece.things, piece.ln_agreement)).collect()
    }

    #[test]
    fn cells_that_hang_together_are_one_piece_however_often_seen() {
        // Eight that agree, two that differ, one that says next to nothing, one apart.
        let spots = [row(0..8, 2.0), row(8..10, -3.0), row(10..11, -0.5), row(20..21, 2.0)].concat();
        let found = says(&spots, &Noise::default());
        assert_eq!(found, [(2.0, 8.0), (1.0, -6.0), (0.25, 2.0)]);
        assert_eq!(says(&spots.repeat(3), &Noise::default()), found);
        assert!(says(&[], &Noise::default()).is_empty());
        // What lies between the edges speaks for itself.
        let both = [row(0..8, 2.0), vec![wear(2, -3.0), wear(3, -3.0)]].concat();
        assert_eq!(says(&both, &Noise::default()), [(2.0, 8.0), (1.0, -6.0)]);
    }

    /// A sheet of paper that lies elsewhere differs in print and in grain.
    #[test]
    fn a_thing_that_has_changed_is_one_fact() {
        let sheet = [row(0..8, 2.0), row(8..10, -3.0)].concat();
        let found = says(&sheet, &Noise::default());
        let grain = [sheet.clone(), vec![wear(8, -3.0), wear(10, -2.0), wear(7, -0.5)]].concat();
        assert_eq!(says(&grain, &Noise::default()), found);
        // The wall behind it is another fact, and so is what agrees.
        let wall = [sheet.clone(), vec![wear(12, -3.0), wear(9, 2.0)]].concat();
        assert_eq!(says(&wall, &Noise::default()), [(2.0, 8.0), (1.0, -6.0), (1.0, 2.0), (1.0, -3.0)]);
        // What differs no more than noise is no change.
        let noise = Noise { depths: vec![7.0], cubes: 10.0 };
        let grain = [sheet, vec![wear(9, -9.0)]].concat();
        assert_eq!(says(&grain, &noise), [(2.0, 8.0), (1.0, -2.0)]);
    }

    /// Where each cube says little, many say much, and none is left out for what it says.
    #[test]
    fn faint_wear_speaks_together() {
        let walls = |says: f64| -> Vec<Spot> {
            (0..40).map(|x| wear(x, if x % 4 == 0 { -says } else { says })).collect()
        };
        for (each, all) in [(0.5, 10.0), (-0.5, -10.0)] {
            let found = says(&walls(each), &Noise::default());
            assert!(
                matches!(found[..], [(things, said)] if things == 1.0 && (said - all).abs() < 1e-9),
                "{found:?}"
            );
        }
    }

    /// One map, seen twice, has four areas that differ by noise: two are expected in each half as much surface.
    #[test]
    fn what_differs_as_one_map_does_from_itself_says_nothing() {
        let params = PlaceParams::default();
        let pass = [row(0..10, 2.0), row(10..12, -2.0), row(12..20, 2.0), row(20..21, -5.0)].concat();
        let noise = Noise::new(&[pass.clone(), pass], &params);
        assert_eq!(noise.depth(21), 4.0);
        assert_eq!(noise.depth(42), 5.0);
        assert_eq!(noise.depth(1000), 5.0);
        let across = [row(0..12, 2.0), row(12..15, -1.2), row(15..20, 2.0), row(20..24, -4.0)].concat();
        assert_eq!(says(&across, &noise), [(3.0, 8.0), (1.25, 8.0), (1.0, -11.0)]);
    }
}
