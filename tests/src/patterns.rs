//! Surfaces of many kinds, for training: what a vocabulary learns from must look like more than one yard.

use geometry::Random;
use std::f32::consts::TAU;

/// A square grey picture that is drawn upon; it tiles.
pub struct Canvas<'a> {
    size: usize,
    values: &'a mut [f32],
}

impl<'a> Canvas<'a> {
    /// `size × size` values, row by row.
    pub fn new(size: usize, values: &'a mut [f32]) -> Self {
        Self { size, values }
    }

    /// Draws one to four kinds of pattern, each many times.
    pub fn decorate(&mut self, random: &mut Random) {
        for _ in 0..1 + random.bits() % 3 {
            match random.bits() % 7 {
                0 => self.bricks(random),
                1 => self.stripes(random),
                2 => self.repeat(random, 500, Self::stroke),
                3 => self.repeat(random, 260, Self::word),
                4 => self.repeat(random, 300, Self::blob),
                5 => self.repeat(random, 120, Self::frame),
                _ => self.repeat(random, 120, Self::shadow),
            }
        }
        self.repeat(random, 60, Self::frame);
    }

    fn repeat(&mut self, random: &mut Random, most: u64, draw: fn(&mut Self, &mut Random)) {
        for _ in 0..most / 3 + random.bits() % most {
            draw(self, random);
        }
    }

    fn add(&mut self, x: f32, y: f32, change: f32) {
        let wrap = |v: f32| v.rem_euclid(self.size as f32) as usize % self.size;
        let at = wrap(y) * self.size + wrap(x);
        self.values[at] += change;
    }

    /// Adds `change(x, y)` over a square of `reach` pixels to each side of a random place.
    fn stamp(&mut self, random: &mut Random, reach: f32, change: impl Fn(f32, f32) -> f32) {
        let size = self.size as f32;
        let (cx, cy) = (random.uniform(0.0, size), random.uniform(0.0, size));
        let side = reach.ceil() as i32;
        for y in -side..=side {
            for x in -side..=side {
                let here = change(x as f32, y as f32);
                if here != 0.0 {
                    self.add(cx + x as f32, cy + y as f32, here);
                }
            }
        }
    }

    /// Bricks or tiles with joints, each a little lighter or darker.
    fn bricks(&mut self, random: &mut Random) {
        let divide = |random: &mut Random, low: f32, high: f32| {
            let count = (self.size as f32 / random.uniform(low, high)).round();
            (self.size as f32 / count, count as usize)
        };
        let (height, rows) = divide(random, 16.0, 90.0);
        let (width, columns) = divide(random, 24.0, 140.0);
        let (joint, depth) = (random.uniform(1.5, 5.0), random.uniform(-70.0, 50.0));
        let tones: Vec<f32> = (0..rows * columns).map(|_| random.uniform(-25.0, 25.0)).collect();
        let shift = if random.bits() & 1 == 0 { 0.5 } else { 0.0 };
        for y in 0..self.size {
            let row = (y as f32 / height) as usize % rows;
            for x in 0..self.size {
                let along = (x as f32 / width + shift * (row % 2) as f32).rem_euclid(columns as f32);
                let inside = along.fract() * width > joint && (y as f32).rem_euclid(height) > joint;
                let tone = tones[row * columns + along as usize % columns];
                self.values[y * self.size + x] += if inside { tone } else { depth };
            }
        }
    }

    /// Planks, corrugation or cloth: waves along one direction.
    fn stripes(&mut self, random: &mut Random) {
        let (kx, ky) = ((random.bits() % 40) as f32, (random.bits() % 40) as f32 + 2.0);
        let (amplitude, sharp) = (random.uniform(10.0, 45.0), random.bits() & 1 == 0);
        for y in 0..self.size {
            for x in 0..self.size {
                let wave = (TAU * (kx * x as f32 + ky * y as f32) / self.size as f32).sin();
                let wave = if sharp { wave.signum() } else { wave };
                self.values[y * self.size + x] += amplitude * wave;
            }
        }
    }

    /// A line that bends: cable, crack, branch.
    fn stroke(&mut self, random: &mut Random) {
        let size = self.size as f32;
        let (mut x, mut y) = (random.uniform(0.0, size), random.uniform(0.0, size));
        let (mut angle, bend) = (random.uniform(0.0, TAU), random.uniform(-0.03, 0.03));
        let (half, change) = (random.uniform(0.6, 4.0), tone(random));
        for _ in 0..random.bits() % 180 + 20 {
            let reach = half as i32;
            for offset in -reach..=reach {
                let (nx, ny) = (-angle.sin() * offset as f32, angle.cos() * offset as f32);
                self.add(x + nx, y + ny, change);
            }
            angle += bend + random.uniform(-0.06, 0.06);
            x += angle.cos();
            y += angle.sin();
        }
    }

    /// A row of made-up letters: sticks and bows on a base line, like print on signs, books and boxes.
    fn word(&mut self, random: &mut Random) {
        let size = self.size as f32;
        let (mut x, y) = (random.uniform(0.0, size), random.uniform(0.0, size));
        let (height, change) = (random.uniform(8.0, 46.0), tone(random));
        let (width, pen) = (0.6 * height, (height / 7.0).max(1.0));
        for _ in 0..random.bits() % 7 + 2 {
            let parts = random.bits();
            let bar = |on: u64, x0: f32, y0: f32, x1: f32, y1: f32| {
                (parts >> on & 1 == 1).then_some([x0, y0, x1, y1])
            };
            let bars = [
                bar(0, 0.0, 0.0, pen, height),
                bar(1, width - pen, 0.0, width, height),
                bar(2, 0.0, 0.0, width, pen),
                bar(3, 0.0, 0.5 * height, width, 0.5 * height + pen),
                bar(4, 0.0, height - pen, width, height),
                bar(5, 0.5 * (width - pen), 0.0, 0.5 * (width + pen), height),
            ];
            for v in 0..height as i32 {
                for u in 0..width as i32 {
                    let (u, v) = (u as f32, v as f32);
                    let inked = bars.iter().flatten().any(|b| u >= b[0] && v >= b[1] && u < b[2] && v < b[3]);
                    if inked {
                        self.add(x + u, y + v, change);
                    }
                }
            }
            x += 1.25 * width;
        }
    }

    /// A soft or sharp ellipse at any angle, full or a ring.
    fn blob(&mut self, random: &mut Random) {
        let (long, short) = (random.uniform(3.0, 60.0), random.uniform(2.0, 40.0));
        let (angle, change) = (random.uniform(0.0, TAU), tone(random));
        let (edge, ring) = (random.uniform(0.02, 0.9), random.bits().is_multiple_of(3));
        let (sin, cos) = angle.sin_cos();
        self.stamp(random, long.max(short) * 1.5, |x, y| {
            let r = ((cos * x + sin * y) / long).hypot((cos * y - sin * x) / short);
            let r = if ring { 4.0 * (r - 0.8).abs() } else { r };
            change * ((1.0 - r) / edge).clamp(0.0, 1.0)
        });
    }

    /// A turned rectangle with an outline: window, drawer, screen, book.
    fn frame(&mut self, random: &mut Random) {
        let (half_x, half_y) = (random.uniform(5.0, 90.0), random.uniform(5.0, 90.0));
        let angle = if random.bits() & 1 == 0 { 0.0 } else { random.uniform(-0.8, 0.8) };
        let (rim, outline, inner) = (random.uniform(1.0, 6.0), tone(random), 0.6 * tone(random));
        let (sin, cos) = f32::sin_cos(angle);
        self.stamp(random, half_x.hypot(half_y), |x, y| {
            let (u, v) = ((cos * x + sin * y).abs(), (cos * y - sin * x).abs());
            match (u < half_x && v < half_y, u < half_x - rim && v < half_y - rim) {
                (_, true) => inner,
                (true, false) => outline,
                (false, false) => 0.0,
            }
        });
    }

    /// A gradient that ends at an edge: the shading of folds and steps.
    fn shadow(&mut self, random: &mut Random) {
        let (reach, angle, change) = (random.uniform(10.0, 90.0), random.uniform(0.0, TAU), tone(random));
        let (sin, cos) = angle.sin_cos();
        self.stamp(random, reach, |x, y| {
            let (u, v) = (cos * x + sin * y, cos * y - sin * x);
            if u < 0.0 || v.abs() > 0.6 * reach { 0.0 } else { change * (1.0 - u / reach).max(0.0) }
        });
    }
}

/// A change of brightness that shows.
fn tone(random: &mut Random) -> f32 {
    random.uniform(18.0, 90.0) * if random.bits() & 1 == 0 { 1.0 } else { -1.0 }
}
