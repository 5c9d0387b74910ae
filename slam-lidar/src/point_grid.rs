//! Points in cells of a metre, for the nearest of a point.

use crate::voxels::{VoxelTable, cell_at, key_of};

/// Edge of a cell and reach of a search, metres.
const CELL: f32 = 1.0;

/// Points in cells; a new one is taken in only where none lies nearer than the leaf size.
#[derive(Clone, Debug)]
pub struct PointGrid {
    leaf: f32,
    table: VoxelTable,
    cells: Vec<Vec<([f32; 3], u16)>>,
    len: usize,
}

impl PointGrid {
    /// An empty grid; `leaf` 0 takes in every point.
    pub fn new(leaf: f32) -> Self {
        Self { leaf, table: VoxelTable::default(), cells: Vec::new(), len: 0 }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds a point with its ring.
    pub fn insert(&mut self, point: [f32; 3], ring: u16) {
        let (index, new) = self.table.get_or_insert(key_of(cell_at(point, 1.0 / CELL)));
        if new {
            self.cells.push(Vec::new());
        }
        let cell = &mut self.cells[index as usize];
        if cell.iter().all(|(p, _)| squared(*p, point) >= self.leaf * self.leaf) {
            cell.push((point, ring));
            self.len += 1;
        }
    }

    /// Calls `visit` with the points of the 27 cells around a point, their rings and squared distances.
    #[inline]
    pub fn around(&self, point: [f32; 3], mut visit: impl FnMut([f32; 3], u16, f32)) {
        let [x, y, z] = cell_at(point, 1.0 / CELL);
        for dx in -1..=1 {
            for dy in -1..=1 {
                for dz in -1..=1 {
                    if let Some(index) = self.table.get(key_of([x + dx, y + dy, z + dz])) {
                        for &(p, ring) in &self.cells[index as usize] {
                            visit(p, ring, squared(p, point));
                        }
                    }
                }
            }
        }
    }

    /// The `N` nearest points within a metre, nearest first; none when there are fewer.
    pub fn nearest<const N: usize>(&self, point: [f32; 3]) -> Option<[[f32; 3]; N]> {
        let mut found = [([0.0; 3], CELL * CELL); N];
        let mut count = 0;
        self.around(point, |p, _, distance| {
            if distance < found[N - 1].1 {
                count += 1;
                let at = found.partition_point(|(_, d)| *d <= distance);
                found[at..].rotate_right(1);
                found[at] = (p, distance);
            }
        });
        (count >= N).then(|| found.map(|(p, _)| p))
    }
}

fn squared(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nearest_are_nearest(
            points in prop::collection::vec(prop::array::uniform3(-2.0f32..2.0), 0..200),
            query in prop::array::uniform3(-2.0f32..2.0),
        ) {
            let mut grid = PointGrid::new(0.0);
            points.iter().for_each(|&p| grid.insert(p, 0));
            let mut distances: Vec<f32> = points.iter().map(|&p| squared(p, query)).filter(|d| *d < 1.0).collect();
            distances.sort_by(f32::total_cmp);
            let found = grid.nearest::<5>(query).map(|f| f.map(|p| squared(p, query)).to_vec());
            prop_assert_eq!(found, (distances.len() >= 5).then(|| distances[..5].to_vec()));
        }
    }
}
