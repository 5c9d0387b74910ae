//! The walls of a map, weighted by heading.
//!
//! Weights whiten by heading, as phase correlation whitens by frequency (Kuglin and Hines 1975): the sides of a corridor coincide
//! at every shift along it, and the few walls across, door frames and ends, say which is right.

use crate::keyframe::Submap;
use crate::voxels::{VoxelTable, cell_at, key_of};
use nalgebra::Vector2;
use std::f64::consts::PI;

/// Steps of a turn about the vertical.
pub(super) const TURNS: usize = 180;
/// Sine of the steepest slope of a wall's normal.
const LEVEL: f32 = 0.3;
/// Edge of the columns in which walls are counted, metres: the grid on which maps are compared.
const COLUMN: f32 = 0.5;
/// Most walls of a map, the highest of all.
const WALLS: usize = 1200;
/// Walls whose headings differ by so many steps of a turn at most weigh as one.
const HEADING_MARGIN: usize = 2;
/// Added to the number of walls of a heading before it is inverted: 10 m of wall, for fewer may be scatter.
const FEW: f32 = 20.0;

/// The middle of a map's walls, and these around it.
pub(super) type Walls = (Vector2<f64>, Vec<Wall>);

/// A column with a wall in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    /// Where it is from the middle, metres.
    pub place: Vector2<f64>,
    /// Heading of the normal, radians in [0, π).
    pub heading: f64,
    /// Points in the column.
    height: usize,
    /// Its weight: all walls of one heading weigh together about as much as those of another.
    pub weight: f32,
}

/// The walls of a submap around their middle, the highest.
pub(super) fn walls(map: &Submap) -> Walls {
    let mut table = VoxelTable::default();
    // Sums of places, of doubled headings, and counts.
    let mut columns: Vec<(Vector2<f64>, Vector2<f64>, usize)> = Vec::new();
    for &p in &map.points {
        let Some(surface) = map.fine.surface_at(p).filter(|s| s.constraints() == 1) else { continue };
        let [nx, ny, nz] = surface.axes[0];
        if nz.abs() > LEVEL {
            continue;
        }
        let (index, new) = table.get_or_insert(key_of(cell_at([p[0], p[1], 0.0], 1.0 / COLUMN)));
        if new {
            columns.push((Vector2::zeros(), Vector2::zeros(), 0));
        }
        let doubled = 2.0 * f64::from(ny).atan2(f64::from(nx));
        let sums = &mut columns[index as usize];
        sums.0 += Vector2::new(f64::from(p[0]), f64::from(p[1]));
        sums.1 += Vector2::new(doubled.cos(), doubled.sin());
        sums.2 += 1;
    }
    let wall = |&(place, doubled, height): &(Vector2<f64>, Vector2<f64>, usize)| Wall {
        place: place / height as f64,
        heading: (0.5 * doubled.y.atan2(doubled.x)).rem_euclid(PI),
        height,
        weight: 0.0,
    };
    let mut found: Vec<Wall> = columns.iter().map(wall).collect();
    // Stable: of equals the one seen first.
    found.sort_by_key(|wall| std::cmp::Reverse(wall.height));
    found.truncate(WALLS);
    let middle = found.iter().map(|wall| wall.place).sum::<Vector2<f64>>() / found.len().max(1) as f64;
    found.iter_mut().for_each(|wall| wall.place -= middle);
    weigh(&mut found);
    (middle, found)
}

/// Gives walls their weights.
fn weigh(walls: &mut [Wall]) {
    const HALF: usize = TURNS / 2;
    let bin = |wall: &Wall| ((wall.heading / PI * HALF as f64) as usize).min(HALF - 1);
    let mut counts = [0u32; HALF];
    walls.iter().for_each(|wall| counts[bin(wall)] += 1);
    for wall in walls {
        let around = |d: usize| counts[(bin(wall) + HALF + d - HEADING_MARGIN) % HALF];
        wall.weight = 1.0 / ((0..=2 * HEADING_MARGIN).map(around).sum::<u32>() as f32 + FEW);
    }
}
