//! The points of a LiDAR keyframe: on a grid, in an order that makes them small in a file.

/// Edge of the grid, metres. A point is moved by half of its diagonal at most, 3.5 mm.
const GRID: f32 = 0.004;
/// Bits of a coordinate: ±4.2 km.
const BITS: u32 = 21;
/// The coordinate of 0.
const ORIGIN: i32 = 1 << (BITS - 1);

/// The points of a scan in its keyframe's frame: x forward, y left, z up, metres.
///
/// They are on a grid of 4 mm, in the order of a Morton curve (G. M. Morton, 1966), no two in one cell. So a scan is
/// a list of ascending numbers with short steps: three bytes a point for a scan thinned to 15 cm, in memory as in a
/// file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scan {
    /// The first cell, then each one's distance from the one before, as variable-length integers (LEB128). A cell is the
    /// coordinates' bits interlaced, x lowest.
    steps: Box<[u8]>,
    /// How many cells these are.
    count: usize,
}

impl Scan {
    /// The scan of points, which are moved to the grid. Those that are not finite or farther than 4 km along an axis are
    /// left out.
    pub fn new(points: impl IntoIterator<Item = [f32; 3]>) -> Self {
        let mut cells: Vec<u64> = points.into_iter().filter_map(cell_of).collect();
        cells.sort_unstable();
        cells.dedup();
        Self::of_ascending(&cells)
    }

    /// The scan of cells as [`cells`](Self::cells) gives them; `None` when they do not ascend or there are no such cells.
    pub(crate) fn from_cells(cells: &[u64]) -> Option<Self> {
        let ascends = cells.windows(2).all(|pair| pair[0] < pair[1]);
        (ascends && cells.last().is_none_or(|last| last >> (3 * BITS) == 0))
            .then(|| Self::of_ascending(cells))
    }

    fn of_ascending(cells: &[u64]) -> Self {
        let (mut steps, mut previous) = (Vec::with_capacity(4 * cells.len()), 0);
        for &cell in cells {
            let mut step = cell - std::mem::replace(&mut previous, cell);
            while step >= 1 << 7 {
                steps.push(step as u8 | 1 << 7);
                step >>= 7;
            }
            steps.push(step as u8);
        }
        Self { steps: steps.into(), count: cells.len() }
    }

    /// Numbers of the points' cells, ascending.
    pub(crate) fn cells(&self) -> impl ExactSizeIterator<Item = u64> + '_ {
        let (mut bytes, mut cell) = (self.steps.iter(), 0);
        (0..self.count).map(move |_| {
            let mut shift = 0;
            for &byte in bytes.by_ref() {
                cell += u64::from(byte & 0x7f) << shift;
                shift += 7;
                if byte & 0x80 == 0 {
                    break;
                }
            }
            cell
        })
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The points, metres.
    pub fn points(&self) -> impl ExactSizeIterator<Item = [f32; 3]> + '_ {
        self.cells().map(|cell| [0, 1, 2].map(|axis| (gathered(cell >> axis) - ORIGIN) as f32 * GRID))
    }
}

/// The cell that a point lies in, if there is one.
fn cell_of(point: [f32; 3]) -> Option<u64> {
    let mut cell = 0;
    for (axis, value) in point.into_iter().enumerate() {
        let at = f64::from(value) / f64::from(GRID) + f64::from(ORIGIN);
        if !(at >= 0.0 && at < f64::from(2 * ORIGIN) - 1.0) {
            return None;
        }
        cell |= spread(at.round() as u64) << axis;
    }
    Some(cell)
}

/// The lowest [`BITS`] bits of a number, two places between each and the next.
fn spread(value: u64) -> u64 {
    let mut bits = value & ((1 << BITS) - 1);
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        bits = (bits | (bits << shift)) & mask;
    }
    bits
}

/// Every third bit of a number, from the lowest on: the inverse of [`spread`].
fn gathered(value: u64) -> i32 {
    let mut bits = value & 0x1249_2492_4924_9249;
    for (shift, mask) in [
        (2, 0x10c3_0c30_c30c_30c3),
        (4, 0x100f_00f0_0f00_f00f),
        (8, 0x001f_0000_ff00_00ff),
        (16, 0x001f_0000_0000_ffff),
        (32, 0x0000_0000_001f_ffff),
    ] {
        bits = (bits | (bits >> shift)) & mask;
    }
    bits as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn points_come_back_within_the_grid(
            points in prop::collection::vec(prop::array::uniform3(-200.0f32..200.0), 0..100),
        ) {
            let scan = Scan::new(points.iter().copied());
            prop_assert!(scan.len() <= points.len());
            for p in &points {
                let off = |q: [f32; 3]| (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f32>().sqrt();
                let nearest = scan.points().map(off).fold(f32::INFINITY, f32::min);
                prop_assert!(nearest < 0.0036, "{nearest}");
            }
            // What lies on the grid stays as it is, to the bit.
            let again = Scan::new(scan.points());
            prop_assert_eq!(&again, &scan);
            prop_assert_eq!(Scan::from_cells(&scan.cells().collect::<Vec<_>>()), Some(scan));
        }
    }

    #[test]
    fn what_has_no_place_on_the_grid_is_left_out() {
        let odd = [[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.0, 0.0, 4500.0], [-4500.0, 0.0, 0.0]];
        assert!(Scan::new(odd).is_empty());
        assert_eq!(Scan::new([[4000.0, -4000.0, 0.0]]).len(), 1);
        for cells in [vec![3, 3], vec![5, 4], vec![1 << 63]] {
            assert_eq!(Scan::from_cells(&cells), None);
        }
    }
}
