//! Bayer mosaics as grey images.
//!
//! Each square of 2×2 pixels has one red, two green and one blue, in one of four orders. The binomial kernel 1-2-1 in
//! both directions weighs red, green and blue around every pixel as 1 : 2 : 1, whatever colour the pixel itself has:
//! its response is zero at the three frequencies of the mosaic. So grey does not flicker from pixel to pixel, and the
//! order need not be known.

use geometry::Image;

/// The grey levels of a mosaic of rows so wide. Rows and columns beyond the border are those mirrored at it, which keeps the order.
pub fn grey<T: Copy + Into<u32> + TryFrom<u32>>(mosaic: &[T], width: usize) -> Vec<T> {
    let height = mosaic.len() / width.max(1);
    let at = |x: usize, y: usize| -> u32 { mosaic[y * width + x].into() };
    let mut grey = Vec::with_capacity(mosaic.len());
    let mut sums = vec![0u32; width];
    for y in 0..height {
        let (above, below) = (mirrored_before(y, height), mirrored_behind(y, height));
        for (x, sum) in sums.iter_mut().enumerate() {
            *sum = at(x, above) + 2 * at(x, y) + at(x, below);
        }
        for x in 0..width {
            let (left, right) = (mirrored_before(x, width), mirrored_behind(x, width));
            let sum = sums[left] + 2 * sums[x] + sums[right];
            // A mean of samples is one.
            grey.extend(T::try_from((sum + 8) / 16));
        }
    }
    grey
}

/// Red, green and blue of all pixels of a mosaic in turn: those of the square of 2×2 that each lies in, the greens'
/// mean. `order` names the colours of a square, row by row: `rggb`. `None` of a mosaic smaller than a square.
pub fn colors<'a>(mosaic: &'a Image<u8>, order: &str) -> Option<impl Iterator<Item = [u8; 3]> + use<'a>> {
    let (width, height) = (mosaic.width(), mosaic.height());
    let place = |letter: char| order.find(letter).map(|at| (at % 2, at / 2));
    let (red, blue) = (place('r')?, place('b')?);
    // The greens are in the same rows as the two, in the other columns.
    let greens = [(1 - red.0, red.1), (1 - blue.0, blue.1)];
    let is_whole = width >= 2 && height >= 2;
    // An odd last row or column has no square of its own.
    let begin = |at: usize, count: usize| (at / 2 * 2).min((count - 2) / 2 * 2);
    let color = move |(x, y)| {
        let (left, top) = (begin(x, width), begin(y, height));
        let at = |(dx, dy): (usize, usize)| mosaic.get(left + dx, top + dy);
        let green = greens.map(|place| u16::from(at(place)));
        [at(red), (green[0] + green[1]).div_ceil(2) as u8, at(blue)]
    };
    is_whole.then(|| (0..height).flat_map(move |y| (0..width).map(move |x| (x, y))).map(color))
}

fn mirrored_before(i: usize, count: usize) -> usize {
    if i == 0 { 1.min(count - 1) } else { i - 1 }
}

fn mirrored_behind(i: usize, count: usize) -> usize {
    if i + 1 == count { count.saturating_sub(2) } else { i + 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An even picture of one colour in the four orders.
    #[test]
    fn an_even_colour_is_an_even_grey_in_every_order() {
        let (r, g, b) = (200u32, 100, 40);
        for order in [[r, g, g, b], [b, g, g, r], [g, b, r, g], [g, r, b, g]] {
            for (width, height) in [(8, 6), (7, 5), (2, 2)] {
                let mosaic: Vec<u16> =
                    (0..width * height).map(|i| order[i / width % 2 * 2 + i % width % 2] as u16).collect();
                let grey = grey(&mosaic, width);
                assert_eq!(grey.len(), mosaic.len());
                assert!(grey.iter().all(|level| *level as u32 == (r + 2 * g + b) / 4), "{grey:?}");
            }
        }
    }

    #[test]
    fn the_largest_samples_fit() {
        assert_eq!(grey(&[255u8; 12], 4), [255; 12]);
        assert_eq!(grey(&[u16::MAX; 12], 3), [u16::MAX; 12]);
        assert_eq!(grey(&[9u8], 1), [9]);
        assert!(grey::<u8>(&[], 0).is_empty());
    }

    /// A ramp of grey light stays one: what is seen does not move.
    #[test]
    fn a_ramp_stays_where_it_is() {
        let mosaic: Vec<u8> = (0..64).map(|i| 3 * (i % 8) as u8).collect();
        let grey = grey(&mosaic, 8);
        assert!((1..7).all(|x| grey[3 * 8 + x] == 3 * x as u8));
    }
}
