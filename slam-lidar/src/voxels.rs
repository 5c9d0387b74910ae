//! A hash table from voxels to dense indices, whose contents never depend on the order of a hash.
//!
//! Values live in vectors beside the table, in the order in which their voxels came; the table itself is never walked.

/// Cells of a grid: integer coordinates packed into one key, 21 bits each.
pub type VoxelKey = u64;

/// No voxel: the largest key is out of range of every axis.
const EMPTY: VoxelKey = u64::MAX;
/// Coordinates range over ±2²⁰ voxels.
const OFFSET: i64 = 1 << 20;

/// The key of the voxel with these coordinates; those out of range wrap, which only far apart voxels notice.
#[inline]
pub fn key_of(cell: [i32; 3]) -> VoxelKey {
    let part = |v: i32| ((i64::from(v) + OFFSET) & 0x1f_ffff) as u64;
    (part(cell[0]) << 42) | (part(cell[1]) << 21) | part(cell[2])
}

/// The coordinates of a key.
#[inline]
pub fn cell_of(key: VoxelKey) -> [i32; 3] {
    let part = |shift: u32| (((key >> shift) & 0x1f_ffff) as i64 - OFFSET) as i32;
    [part(42), part(21), part(0)]
}

/// The voxel of a point on a grid of `1 / inverse_size`.
#[inline]
pub fn cell_at(point: [f32; 3], inverse_size: f32) -> [i32; 3] {
    // Rounds down as `floor` does, which is a call on processors of before SSE 4.1.
    point.map(|v| {
        let cell = (v * inverse_size) as i32;
        cell - i32::from((cell as f32) > v * inverse_size)
    })
}

/// Open addressing from keys to dense indices.
#[derive(Clone, Debug)]
pub struct VoxelTable {
    slots: Vec<(VoxelKey, u32)>,
    len: usize,
}

impl Default for VoxelTable {
    fn default() -> Self {
        Self { slots: vec![(EMPTY, 0); 1024], len: 0 }
    }
}

impl VoxelTable {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no voxel.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Forgets all voxels and keeps the room.
    pub fn clear(&mut self) {
        self.slots.fill((EMPTY, 0));
        self.len = 0;
    }

    #[inline]
    fn first_slot(&self, key: VoxelKey) -> usize {
        // Fibonacci hashing; the upper half mixes in all bits of the key.
        let hash = (key ^ (key >> 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (hash >> 32) as usize & (self.slots.len() - 1)
    }

    /// The index of a voxel.
    #[inline]
    pub fn get(&self, key: VoxelKey) -> Option<u32> {
        let mut slot = self.first_slot(key);
        loop {
            match self.slots[slot] {
                (k, index) if k == key => return Some(index),
                (EMPTY, _) => return None,
                _ => slot = (slot + 1) & (self.slots.len() - 1),
            }
        }
    }

    /// The index of a voxel, and whether it is new: new ones are numbered in the order of their coming.
    #[inline]
    pub fn get_or_insert(&mut self, key: VoxelKey) -> (u32, bool) {
        if (self.len + 1) * 2 > self.slots.len() {
            self.grow();
        }
        let mut slot = self.first_slot(key);
        loop {
            match self.slots[slot] {
                (k, index) if k == key => return (index, false),
                (EMPTY, _) => {
                    let index = self.len as u32;
                    self.slots[slot] = (key, index);
                    self.len += 1;
                    return (index, true);
                }
                _ => slot = (slot + 1) & (self.slots.len() - 1),
            }
        }
    }

    fn grow(&mut self) {
        let doubled = vec![(EMPTY, 0); self.slots.len() * 2];
        for (key, index) in std::mem::replace(&mut self.slots, doubled) {
            if key != EMPTY {
                let mut slot = self.first_slot(key);
                while self.slots[slot].0 != EMPTY {
                    slot = (slot + 1) & (self.slots.len() - 1);
                }
                self.slots[slot] = (key, index);
            }
        }
    }
}

/// Thins points to the first of each voxel: their indices, ascending. `table` is scratch.
pub fn first_of_each_voxel(points: &[[f32; 3]], size: f32, table: &mut VoxelTable, kept: &mut Vec<u32>) {
    table.clear();
    kept.clear();
    let inverse = 1.0 / size;
    for (i, &point) in points.iter().enumerate() {
        if table.get_or_insert(key_of(cell_at(point, inverse))).1 {
            kept.push(i as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn behaves_like_a_map(cells in prop::collection::vec(prop::array::uniform3(-30i32..30), 0..3000)) {
            let (mut table, mut model) = (VoxelTable::default(), BTreeMap::new());
            for cell in cells {
                let next = model.len() as u32;
                let expected = *model.entry(cell).or_insert(next);
                prop_assert_eq!(table.get_or_insert(key_of(cell)), (expected, expected == next));
                prop_assert_eq!(cell_of(key_of(cell)), cell);
            }
            prop_assert_eq!(table.len(), model.len());
            prop_assert!(model.iter().all(|(&cell, &index)| table.get(key_of(cell)) == Some(index)));
            prop_assert_eq!(table.get(key_of([31, 0, 0])), None);
        }
    }
}
