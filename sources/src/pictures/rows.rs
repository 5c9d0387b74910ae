//! Rows of images that hold numbers in place of a picture. Thermal cameras send their telemetry (counters,
//! temperatures, serial numbers) as the first or last rows. They would decide the range of grey and be tracked as
//! texture.

use geometry::Image;

/// So many rows at one end may be numbers, at least and as a share of the height: cameras send 1 to 4.
const MOST: (usize, usize) = (4, 16);
/// Numbers begin where a row differs from the next by so many times what any two of the picture's rows beside each other do.
const STEP: f64 = 4.0;
/// Of numbers more than this share is 0, which a sensor says where it has nothing, or lies off the levels that 98 of 100 of the picture's
/// pixels have by more than these span; or they go up and down so many times as much as any row of the picture.
const OUTSIDE: f64 = 0.5;
/// So many of a recording's first images are asked: first, middle and last.
const ASKED: usize = 3;

/// How many rows at the top and at the bottom hold no picture in any of these images, which are one camera's.
pub fn of_numbers(images: &[Image<u16>]) -> [u16; 2] {
    let last = images.len().saturating_sub(1);
    let mut asked: Vec<usize> = (0..ASKED).map(|i| i * last / (ASKED - 1)).collect();
    asked.dedup();
    let both = asked.into_iter().filter_map(|i| rows_of(images.get(i)?));
    // What is a picture in one image is none of numbers.
    let least = both.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1])]);
    least.unwrap_or_default().map(|rows| rows as u16)
}

/// How many rows at the top and at the bottom are numbers; `None` of an image that says nothing, for it is even or too small.
fn rows_of(image: &Image<u16>) -> Option<[usize; 2]> {
    let (width, height) = (image.width(), image.height());
    let most = MOST.0.max(height / MOST.1);
    if width == 0 || height < 4 * most {
        return None;
    }
    let step = |upper: &[u16], lower: &[u16]| {
        upper.iter().zip(lower).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>()
    };
    let inner = &image.data()[most * width..(height - most) * width];
    let rows: Vec<&[u16]> = inner.chunks_exact(width).collect();
    let largest = rows.windows(2).map(|pair| step(pair[0], pair[1])).max()?;
    /// Of so many pixels one tells the levels.
    const LOOKED_AT: usize = 7;
    let mut levels: Vec<u16> = inner.iter().step_by(LOOKED_AT).copied().collect();
    let (tail, last) = (levels.len() / 100, levels.len() - 1);
    let [low, high] = [tail, last - tail].map(|at| *levels.select_nth_unstable(at).1);
    if low == high {
        return None;
    }
    let along = |row: &[u16]| step(row, &row[1..]);
    let most_along = rows.iter().map(|row| along(row)).max()?;
    let far = high - low;
    let (low, high) = (low.saturating_sub(far).max(1), high.saturating_add(far));
    let is_outside = |row: &[u16]| {
        row.iter().filter(|level| !(low..=high).contains(*level)).count() as f64 > OUTSIDE * width as f64
    };
    let are_numbers = |row: &[u16]| is_outside(row) || along(row) as f64 > STEP * most_along as f64;
    Some([false, true].map(|at_bottom| {
        let row = |from_end: usize| {
            let y = if at_bottom { height - 1 - from_end } else { from_end };
            &image.data()[y * width..(y + 1) * width]
        };
        let begins = |rows: &usize| step(row(*rows - 1), row(*rows)) as f64 > STEP * largest as f64;
        let found = (1..=most).rev().find(begins).unwrap_or(0);
        if (0..found).all(|from_end| are_numbers(row(from_end))) { found } else { 0 }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture between two levels with noise, of which the last rows are replaced.
    fn image(seed: usize, levels: (u16, u16), numbers: &[&dyn Fn(usize) -> u16]) -> Image<u16> {
        let (width, height) = (80, 64);
        let span = f64::from(levels.1 - levels.0);
        let mut data: Vec<u16> = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f64, (i / width) as f64);
                let wave = 0.5 + 0.3 * (0.2 * x + seed as f64).sin() * (0.15 * y).cos();
                levels.0 + (span * (wave + 0.02 * ((i * 7919 + seed) % 13) as f64 / 13.0)) as u16
            })
            .collect();
        for (i, number) in numbers.iter().enumerate() {
            let y = height - numbers.len() + i;
            (0..width).for_each(|x| data[y * width + x] = number(x));
        }
        Image::from_vec(width, height, data).unwrap()
    }

    fn found(levels: (u16, u16), numbers: &[&dyn Fn(usize) -> u16]) -> [u16; 2] {
        of_numbers(&[0, 5, 9].map(|seed| image(seed, levels, numbers)))
    }

    #[test]
    fn rows_of_numbers_are_none_of_the_picture() {
        let words = |x: usize| if x.is_multiple_of(4) { (x * 9973 % 65536) as u16 } else { 0 };
        let (zeros, full) = (|_: usize| 0, |_: usize| u16::MAX);
        for levels in [(29_000, 30_500), (7_000, 7_400), (300, 3_800)] {
            assert_eq!(found(levels, &[]), [0, 0], "{levels:?}");
            assert_eq!(found(levels, &[&words]), [0, 1], "{levels:?}");
            assert_eq!(found(levels, &[&words, &zeros, &zeros]), [0, 3], "{levels:?}");
            assert_eq!(found(levels, &[&full, &words]), [0, 2], "{levels:?}");
        }
    }

    #[test]
    fn a_hot_or_cold_edge_of_the_scene_is_a_picture() {
        let (warm, cold) = (|_: usize| 30_400, |_: usize| 29_050);
        assert_eq!(found((29_000, 30_500), &[&warm, &warm]), [0, 0]);
        assert_eq!(found((29_000, 30_500), &[&cold]), [0, 0]);
        // In one image only.
        let zeros = |_: usize| 0;
        let (plain, torn) = (image(1, (7000, 7400), &[]), image(2, (7000, 7400), &[&zeros, &zeros]));
        assert_eq!(of_numbers(&[plain, torn]), [0, 0]);
        assert_eq!(of_numbers(&[Image::from_vec(80, 64, vec![5; 80 * 64]).unwrap()]), [0, 0]);
        assert_eq!(of_numbers(&[]), [0, 0]);
    }

    #[test]
    fn numbers_may_be_in_the_high_bits() {
        let flipped = |image: Image<u16>| {
            let rows: Vec<u16> = image.data().chunks_exact(80).rev().flatten().copied().collect();
            Image::from_vec(80, 64, rows).unwrap()
        };
        let words = |x: usize| (x * 40_503 % 65_536) as u16;
        let images = [3, 4].map(|seed| flipped(image(seed, (29_000, 30_500), &[&words, &words])));
        assert_eq!(of_numbers(&images), [2, 0]);
    }
}
