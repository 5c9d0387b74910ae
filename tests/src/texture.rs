//! Procedural textures with mip levels.

use crate::patterns::Canvas;
use geometry::Random;
use std::sync::Arc;

/// Side of level 0 in texels, a power of two.
const SIZE: usize = 1024;

/// A tiling grey texture of 1024 × 1024 texels with its mip levels, so that a far surface is as
/// smooth as a camera would see it.
#[derive(Clone)]
pub struct Texture {
    levels: Arc<Vec<Level>>,
    grain: Option<Grain>,
}

/// What a surface has for itself, over what all of its make have: stains, wear and the grain of its stuff, at all scales.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grain {
    /// Another seed is another surface.
    pub seed: u64,
    /// Its standard deviation, grey levels.
    pub deviation: f32,
}

/// Sizes of a grain's cells, texels.
const GRAIN_CELLS: [f32; 5] = [3.0, 6.0, 12.0, 24.0, 48.0];

/// One mip level; `size` is a power of two.
struct Level {
    size: usize,
    data: Vec<u8>,
}

impl Texture {
    /// Texels along a side of level 0.
    pub const SIZE: usize = SIZE;

    /// Value noise of six octaves under a few hundred sharp-edged rectangles, discs and checkers:
    /// gradients of every direction and at every scale. Another `seed` gives another texture.
    pub fn procedural(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut values = vec![128.0f32; SIZE * SIZE];
        for (cells, amplitude) in [(8, 30.0), (16, 24.0), (32, 18.0), (64, 14.0), (128, 12.0), (256, 9.0)] {
            add_noise(&mut values, cells, amplitude, &mut random);
        }
        for _ in 0..700 {
            add_stamp(&mut values, &mut random);
        }
        Self::with_levels(&values)
    }

    /// A surface of some kind or other, another for each seed: noise of any roughness, and on it bricks, planks,
    /// print, lines, blobs, windows or shading.
    pub fn varied(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut values = vec![random.uniform(70.0, 190.0); SIZE * SIZE];
        let (mut amplitude, fall) = (random.uniform(4.0, 40.0), random.uniform(0.5, 1.0));
        for cells in [8, 16, 32, 64, 128, 256] {
            add_noise(&mut values, cells, amplitude, &mut random);
            amplitude *= fall;
        }
        Canvas::new(SIZE, &mut values).decorate(&mut random);
        Self::with_levels(&values)
    }

    /// As `paint` says of each texel: grey levels 0 to 255 of column and row, from 0 to [`Texture::SIZE`].
    pub fn painted(paint: impl Fn(usize, usize) -> f32) -> Self {
        let values: Vec<f32> = (0..SIZE * SIZE).map(|i| paint(i % SIZE, i / SIZE)).collect();
        Self::with_levels(&values)
    }

    /// Clamps level 0 and halves it down to one texel.
    fn with_levels(values: &[f32]) -> Self {
        let data = values.iter().map(|v| v.clamp(8.0, 247.0) as u8).collect();
        let mut levels = vec![Level { size: SIZE, data }];
        while levels[levels.len() - 1].size > 1 {
            let next = levels[levels.len() - 1].halved();
            levels.push(next);
        }
        Self { levels: Arc::new(levels), grain: None }
    }

    /// The same on a surface that has a grain of its own.
    pub fn with_grain(&self, grain: Grain) -> Self {
        Self { levels: Arc::clone(&self.levels), grain: Some(grain) }
    }

    /// Intensity at `(u, v)`, in texels of level 0, averaged over about `footprint` texels; tiles.
    pub fn sample(&self, u: f32, v: f32, footprint: f32) -> f32 {
        let level = footprint.max(1.0).log2().min((self.levels.len() - 1) as f32);
        let fine = level as usize;
        let coarse = (fine + 1).min(self.levels.len() - 1);
        let a = self.levels[fine].bilinear(u, v);
        let b = self.levels[coarse].bilinear(u, v);
        let own = self.grain.map_or(0.0, |grain| grain.sample(u, v, footprint));
        a + (level - fine as f32) * (b - a) + own
    }
}

impl Grain {
    /// Value noise of cells of all sizes that a pixel of so many texels does not blur.
    fn sample(&self, u: f32, v: f32, footprint: f32) -> f32 {
        // A cell's corners are evenly distributed, and what lies between them has half of their variance.
        let amplitude = self.deviation * (6.0 / GRAIN_CELLS.len() as f32).sqrt();
        let octave = |(number, cell): (usize, &f32)| {
            let sharp = (2.0 - footprint / cell).clamp(0.0, 1.0);
            if sharp > 0.0 { sharp * self.noise(number as u64, u / cell, v / cell) } else { 0.0 }
        };
        amplitude * GRAIN_CELLS.iter().enumerate().map(octave).sum::<f32>()
    }

    fn noise(&self, octave: u64, x: f32, y: f32) -> f32 {
        let (x0, y0) = (floor(x), floor(y));
        let (dx, dy) = (x - x0 as f32, y - y0 as f32);
        let at = |x: i32, y: i32| {
            let mut bits = self.seed ^ octave.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            for part in [x, y] {
                bits = (bits ^ part as u32 as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                bits ^= bits >> 29;
            }
            (bits >> 40) as f32 / 8_388_608.0 - 1.0
        };
        let top = at(x0, y0) + dx * (at(x0 + 1, y0) - at(x0, y0));
        let bottom = at(x0, y0 + 1) + dx * (at(x0 + 1, y0 + 1) - at(x0, y0 + 1));
        top + dy * (bottom - top)
    }
}

impl Level {
    fn halved(&self) -> Level {
        let size = self.size / 2;
        let texel = |x: usize, y: usize| self.data[y * self.size + x] as u32;
        let mean = |i: usize| {
            let (x, y) = (2 * (i % size), 2 * (i / size));
            ((texel(x, y) + texel(x + 1, y) + texel(x, y + 1) + texel(x + 1, y + 1) + 2) / 4) as u8
        };
        Level { size, data: (0..size * size).map(mean).collect() }
    }

    /// Bilinear value at `(u, v)` given in texels of level 0.
    fn bilinear(&self, u: f32, v: f32) -> f32 {
        let scale = self.size as f32 / SIZE as f32;
        let (x, y) = ((u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5);
        let (x0, y0) = (floor(x), floor(y));
        let (dx, dy) = (x - x0 as f32, y - y0 as f32);
        let mask = self.size as i32 - 1;
        let (left, right) = ((x0 & mask) as usize, ((x0 + 1) & mask) as usize);
        let top = (y0 & mask) as usize * self.size;
        let bottom = ((y0 + 1) & mask) as usize * self.size;
        let at = |i: usize| self.data[i] as f32;
        let t = at(top + left) + dx * (at(top + right) - at(top + left));
        let b = at(bottom + left) + dx * (at(bottom + right) - at(bottom + left));
        t + dy * (b - t)
    }
}

/// `x.floor()` without the library call that baseline x86-64 makes of it.
fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(x < truncated as f32)
}

/// Adds one octave of tiling value noise: random values on a lattice of `cells × cells`, smoothly interpolated.
fn add_noise(values: &mut [f32], cells: usize, amplitude: f32, random: &mut Random) {
    let lattice: Vec<f32> = (0..cells * cells).map(|_| random.uniform(-amplitude, amplitude)).collect();
    let step = SIZE / cells;
    let weights: Vec<f32> = (0..step)
        .map(|i| {
            let t = i as f32 / step as f32;
            t * t * (3.0 - 2.0 * t)
        })
        .collect();
    for (y, row) in values.chunks_exact_mut(SIZE).enumerate() {
        let (cy, wy) = (y / step, weights[y % step]);
        let top = &lattice[cy * cells..][..cells];
        let bottom = &lattice[(cy + 1) % cells * cells..][..cells];
        for (x, value) in row.iter_mut().enumerate() {
            let (cx, wx) = (x / step, weights[x % step]);
            let next = (cx + 1) % cells;
            let t = top[cx] + wx * (top[next] - top[cx]);
            let b = bottom[cx] + wx * (bottom[next] - bottom[cx]);
            *value += t + wy * (b - t);
        }
    }
}

/// Brightens or darkens a rectangle, disc or checkered rectangle somewhere.
fn add_stamp(values: &mut [f32], random: &mut Random) {
    let (width, height) = (random.uniform(6.0, 70.0) as usize, random.uniform(6.0, 70.0) as usize);
    let (left, top) = (random.bits() as usize % SIZE, random.bits() as usize % SIZE);
    let change = random.uniform(20.0, 65.0) * if random.bits() & 1 == 0 { 1.0 } else { -1.0 };
    let kind = random.bits() % 5;
    for y in 0..height {
        for x in 0..width {
            let (rx, ry) = (2.0 * x as f32 / width as f32 - 1.0, 2.0 * y as f32 / height as f32 - 1.0);
            let inside = match kind {
                0 | 1 => rx * rx + ry * ry < 1.0,
                2 => (x / 8 + y / 8) % 2 == 0,
                _ => true,
            };
            if inside {
                values[(top + y) % SIZE * SIZE + (left + x) % SIZE] += change;
            }
        }
    }
}
