//! How sharp corners are in an image.

use geometry::GrayImage;
use nalgebra::Vector2;

/// Directions along which edges are looked at; half a turn holds all of them.
const DIRECTIONS: usize = 8;
/// Less contrast than this around a corner, grey levels, says nothing.
const MIN_CONTRAST: f32 = 12.0;

/// Width of the edges at the corners of a board, pixels: the median over the corners of contrast over steepest slope,
/// in the direction in which that is least steep, so that motion blur along one direction counts. About 2 for a sharp
/// image, about 2.5 times the deviation of a Gaussian blur; `radius` (pixels) is how far around a corner is looked.
/// `None` when no corner has contrast.
pub fn edge_width(image: &GrayImage, corners: &[Vector2<f64>], radius: usize) -> Option<f64> {
    let mut widths: Vec<f32> = corners.iter().filter_map(|corner| width_at(image, corner, radius)).collect();
    widths.sort_by(f32::total_cmp);
    widths.get(widths.len() / 2).map(|width| f64::from(*width))
}

fn width_at(image: &GrayImage, corner: &Vector2<f64>, radius: usize) -> Option<f32> {
    if !image.contains(corner.x as f32, corner.y as f32, radius as f32 + 2.0) {
        return None;
    }
    let (x, y) = (corner.x.round() as usize, corner.y.round() as usize);
    let (mut darkest, mut brightest) = (255u8, 0u8);
    let mut steepest = [0.0f32; DIRECTIONS];
    for v in y - radius..=y + radius {
        for u in x - radius..=x + radius {
            let level = image.get(u, v);
            (darkest, brightest) = (darkest.min(level), brightest.max(level));
            let slope = |a: u8, b: u8| 0.5 * (f32::from(a) - f32::from(b));
            let gx = slope(image.get(u + 1, v), image.get(u - 1, v));
            let gy = slope(image.get(u, v + 1), image.get(u, v - 1));
            for (i, steepest) in steepest.iter_mut().enumerate() {
                let (sin, cos) = (i as f32 * std::f32::consts::PI / DIRECTIONS as f32).sin_cos();
                *steepest = steepest.max((gx * cos + gy * sin).abs());
            }
        }
    }
    let contrast = f32::from(brightest) - f32::from(darkest);
    let least = steepest.iter().copied().fold(f32::INFINITY, f32::min);
    (contrast >= MIN_CONTRAST && least > 0.0).then(|| contrast / least)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A corner of a chessboard, blurred by a box of `across × down` pixels.
    fn corner(across: usize, down: usize) -> GrayImage {
        let mut image = GrayImage::filled(60, 60, 0);
        for y in 0..60usize {
            for x in 0..60usize {
                let mut sum = 0;
                for v in 0..down {
                    for u in 0..across {
                        let (x, y) = (x + u, y + v);
                        sum += if (x < 30 + across / 2) == (y < 30 + down / 2) { 200 } else { 20 };
                    }
                }
                image.set(x, y, (sum / (across * down)) as u8);
            }
        }
        image
    }

    #[test]
    fn blur_in_any_direction_widens_edges() {
        let width =
            |across, down| edge_width(&corner(across, down), &[Vector2::new(30.0, 30.0)], 14).unwrap();
        assert!(width(1, 1) < 3.1, "{}", width(1, 1));
        assert!(width(9, 9) > 8.0, "{}", width(9, 9));
        assert!(width(9, 1) > 8.0 && width(1, 9) > 8.0, "{} {}", width(9, 1), width(1, 9));
        assert_eq!(edge_width(&GrayImage::filled(60, 60, 90), &[Vector2::new(30.0, 30.0)], 9), None);
        assert_eq!(edge_width(&corner(1, 1), &[Vector2::new(2.0, 30.0)], 9), None);
    }
}
