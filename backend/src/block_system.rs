//! Sparse normal equations of least squares over poses: square blocks in a fixed pattern, factorised by Cholesky.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{LltRef, SymbolicCholesky, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side, Spec};
use nalgebra::{SMatrix, SVector};
use thiserror::Error;

/// `H δ = −g` over nodes of `DIM` unknowns each; the lower triangle of H in compressed columns.
///
/// The pattern and its symbolic factorisation are made once; values are refilled each iteration. A solve works on
/// a damped copy of H and g, from which other unknowns may be eliminated first (the Schur complement).
pub struct BlockSystem<const DIM: usize> {
    /// The rows of the blocks in each column of blocks, ascending, the diagonal first.
    rows: Vec<Vec<u32>>,
    pattern: SymbolicSparseColMat<u32>,
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
    gradient: Vec<f64>,
    damped: Vec<f64>,
    reduced: Vec<f64>,
    factor: Vec<f64>,
    buffer: MemBuffer,
}

/// Where the off-diagonal block of a pair of nodes lies.
#[derive(Clone, Copy, Debug)]
pub struct BlockSlot {
    column: u32,
    position: u32,
}

/// Why a system cannot be set up.
#[derive(Clone, Debug, PartialEq, Error, serde::Serialize, serde::Deserialize)]
#[error("a system of {nodes} nodes cannot be set up: {reason}; split the map")]
pub struct SystemError {
    /// Nodes of the system.
    pub nodes: usize,
    /// What was in the way.
    pub reason: String,
}

impl<const DIM: usize> BlockSystem<DIM> {
    /// The system of `nodes` nodes coupled by `pairs` (each `(greater, smaller)` index).
    ///
    /// # Errors
    /// When there is not enough memory, or the system has more entries than can be numbered.
    pub fn new(nodes: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Result<Self, SystemError> {
        let failed = |reason: String| SystemError { nodes, reason };
        let mut rows: Vec<Vec<u32>> = (0..nodes as u32).map(|node| vec![node]).collect();
        for (greater, smaller) in pairs {
            rows[smaller].push(greater as u32);
        }
        for column in &mut rows {
            column.sort_unstable();
            column.dedup();
        }
        let entries: usize = rows.iter().map(|column| column.len() * DIM * DIM).sum();
        if u32::try_from(entries).is_err() {
            return Err(failed(format!("it has {entries} entries")));
        }
        let (column_starts, row_indices) = expand_blocks::<DIM>(&rows);
        let size = nodes * DIM;
        let nonzeros = row_indices.len();
        let pattern = SymbolicSparseColMat::new_checked(size, size, column_starts, None, row_indices);
        let symbolic = factorize_symbolic_cholesky(
            pattern.as_ref(),
            Side::Lower,
            Default::default(),
            Default::default(),
        )
        .map_err(|error| failed(format!("{error:?}")))?;
        let scratch =
            symbolic
                .factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default())
                .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let buffer =
            MemBuffer::try_new(scratch).map_err(|_| failed("not enough memory to factorise it".into()))?;
        Ok(Self {
            rows,
            values: vec![0.0; nonzeros],
            gradient: vec![0.0; size],
            damped: vec![0.0; nonzeros],
            reduced: vec![0.0; size],
            factor: vec![0.0; symbolic.len_val()],
            pattern,
            symbolic,
            buffer,
        })
    }

    /// The slot of a pair given to [`BlockSystem::new`], `greater` > `smaller`.
    #[inline]
    pub fn slot(&self, greater: usize, smaller: usize) -> BlockSlot {
        let rows = &self.rows[smaller];
        // Where each node is coupled with those that follow it, as poses along a path are, this is the place.
        let likely = (greater - smaller).min(rows.len() - 1);
        let position = if rows[likely] as usize == greater {
            likely
        } else {
            rows.partition_point(|&row| (row as usize) < greater)
        };
        BlockSlot { column: smaller as u32, position: position as u32 }
    }

    /// Sets H and g to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradient.fill(0.0);
    }

    /// Adds a node's own block and gradient.
    pub fn add_node(&mut self, node: usize, block: &SMatrix<f64, DIM, DIM>, gradient: &SVector<f64, DIM>) {
        let starts = &self.pattern.col_ptr()[node * DIM..];
        add_diagonal(&mut self.values, starts, block);
        self.gradient[node * DIM..][..DIM].iter_mut().zip(gradient.iter()).for_each(|(sum, g)| *sum += g);
    }

    /// Adds the block of a pair, rows of the greater node, columns of the smaller.
    pub fn add_pair(&mut self, slot: BlockSlot, block: &SMatrix<f64, DIM, DIM>) {
        let starts = &self.pattern.col_ptr()[slot.column as usize * DIM..];
        add_block(&mut self.values, starts, slot.position as usize, block);
    }

    /// Begins a solve with a damped copy of the system: `added(entry)` comes on top of each diagonal entry.
    pub fn damp(&mut self, added: impl Fn(f64) -> f64) {
        self.damped.copy_from_slice(&self.values);
        for &start in &self.pattern.col_ptr()[..self.gradient.len()] {
            self.damped[start as usize] += added(self.values[start as usize]);
        }
        self.reduced.copy_from_slice(&self.gradient);
    }

    /// Adds to a node's block and gradient in the damped copy.
    #[inline(always)]
    pub fn reduce_node(&mut self, node: usize, block: &SMatrix<f64, DIM, DIM>, gradient: &SVector<f64, DIM>) {
        let starts = &self.pattern.col_ptr()[node * DIM..];
        add_diagonal(&mut self.damped, starts, block);
        self.reduced[node * DIM..][..DIM].iter_mut().zip(gradient.iter()).for_each(|(sum, g)| *sum += g);
    }

    /// Adds to the block of a pair in the damped copy.
    #[inline(always)]
    pub fn reduce_pair(&mut self, slot: BlockSlot, block: &SMatrix<f64, DIM, DIM>) {
        let starts = &self.pattern.col_ptr()[slot.column as usize * DIM..];
        add_block(&mut self.damped, starts, slot.position as usize, block);
    }

    /// The step `δ` of the damped copy, `DIM` entries a node; `None` when it is not positive definite.
    pub fn solve(&mut self) -> Option<Vec<f64>> {
        let mut step: Vec<f64> = self.reduced.iter().map(|g| -g).collect();
        let size = step.len();
        if size == 0 {
            return Some(step);
        }
        let stack = MemStack::new(&mut self.buffer);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(self.pattern.as_ref(), &self.damped),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                stack,
                Spec::default(),
            )
            .ok()?;
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(&mut step, size, 1),
            Par::Seq,
            stack,
        );
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Solves the damped copy for another right-hand side, in place, by the factor that [`BlockSystem::solve`] made.
    pub fn solve_again(&mut self, side: &mut [f64]) {
        let size = self.gradient.len();
        if size == 0 || side.len() != size {
            return;
        }
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(side, size, 1),
            Par::Seq,
            MemStack::new(&mut self.buffer),
        );
    }

    /// The diagonal of H.
    pub fn diagonal(&self) -> impl Iterator<Item = f64> + '_ {
        self.pattern.col_ptr()[..self.gradient.len()].iter().map(|&start| self.values[start as usize])
    }

    /// The gradient g.
    pub fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    /// Entries of H that are stored: what a pass over the system costs.
    pub fn entries(&self) -> usize {
        self.values.len()
    }
}

/// Adds the lower triangle of a diagonal block; `starts` are those of its scalar columns.
#[inline(always)]
fn add_diagonal<const DIM: usize>(values: &mut [f64], starts: &[u32], block: &SMatrix<f64, DIM, DIM>) {
    for c in 0..DIM {
        let column = &mut values[starts[c] as usize..][..DIM - c];
        column.iter_mut().enumerate().for_each(|(r, sum)| *sum += block[(c + r, c)]);
    }
}

/// Adds a block below the diagonal, the one at `position` in its column of blocks.
#[inline(always)]
fn add_block<const DIM: usize>(
    values: &mut [f64],
    starts: &[u32],
    position: usize,
    block: &SMatrix<f64, DIM, DIM>,
) {
    for c in 0..DIM {
        // The diagonal block of scalar column c holds only its DIM − c lower entries.
        let start = starts[c] as usize + DIM - c + DIM * (position - 1);
        let column = &mut values[start..][..DIM];
        column.iter_mut().enumerate().for_each(|(r, sum)| *sum += block[(r, c)]);
    }
}

/// Scalar compressed columns of the lower triangle of a block pattern whose columns begin with
/// their diagonal block.
fn expand_blocks<const DIM: usize>(block_rows: &[Vec<u32>]) -> (Vec<u32>, Vec<u32>) {
    let dim = DIM as u32;
    let mut starts = vec![0];
    let mut rows = Vec::new();
    for (node, column) in block_rows.iter().enumerate() {
        let node = node as u32;
        for c in 0..dim {
            rows.extend(node * dim + c..(node + 1) * dim);
            for &row in &column[1..] {
                rows.extend(row * dim..(row + 1) * dim);
            }
            starts.push(rows.len() as u32);
        }
    }
    (starts, rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Four nodes in a chain with one more coupling, filled with numbers that make it positive definite.
    fn filled() -> (BlockSystem<3>, DMatrix<f64>, DVector<f64>) {
        let pairs = [(1, 0), (2, 1), (3, 2), (3, 0)];
        let mut system = BlockSystem::<3>::new(4, pairs).unwrap();
        let (mut dense, mut right) = (DMatrix::zeros(12, 12), DVector::zeros(12));
        let number = |i: usize| ((i as f64 * 0.618).fract() - 0.5) * 0.8;
        for node in 0..4 {
            let noise = SMatrix::<f64, 3, 3>::from_fn(|r, c| number(node + 3 * r + 5 * c));
            let block = SMatrix::<f64, 3, 3>::identity() * 4.0 + noise * noise.transpose();
            let gradient = SVector::<f64, 3>::from_fn(|r, _| number(7 * node + r));
            system.add_node(node, &block, &gradient);
            dense.view_mut((3 * node, 3 * node), (3, 3)).copy_from(&block);
            right.rows_mut(3 * node, 3).copy_from(&gradient);
        }
        for (i, (greater, smaller)) in pairs.into_iter().enumerate() {
            let block = SMatrix::<f64, 3, 3>::from_fn(|r, c| number(11 * i + 2 * r + c));
            system.add_pair(system.slot(greater, smaller), &block);
            dense.view_mut((3 * greater, 3 * smaller), (3, 3)).copy_from(&block);
            dense.view_mut((3 * smaller, 3 * greater), (3, 3)).copy_from(&block.transpose());
        }
        (system, dense, right)
    }

    #[test]
    fn a_sparse_solve_is_that_of_the_dense_system() {
        let (mut system, mut dense, mut right) = filled();
        system.damp(|entry| 0.1 * entry);
        for i in 0..12 {
            dense[(i, i)] *= 1.1;
        }
        let block = SMatrix::<f64, 3, 3>::identity() * -0.3;
        let gradient = SVector::<f64, 3>::repeat(0.2);
        system.reduce_node(2, &block, &gradient);
        system.reduce_pair(system.slot(3, 0), &block);
        for i in 0..3 {
            dense[(6 + i, 6 + i)] -= 0.3;
            dense[(9 + i, i)] -= 0.3;
            dense[(i, 9 + i)] -= 0.3;
            right[6 + i] += 0.2;
        }
        let step = DVector::from_vec(system.solve().expect("it is positive definite"));
        let expected = -dense.clone().lu().solve(&right).unwrap();
        assert!((step - expected).norm() < 1e-12);
        // The next solve begins from the system as it was filled.
        system.damp(|_| 0.0);
        let (_, dense, right) = filled();
        let step = DVector::from_vec(system.solve().unwrap());
        assert!((dense * step + right).norm() < 1e-12);
    }

    #[test]
    fn an_indefinite_system_is_refused() {
        let (mut system, ..) = filled();
        system.damp(|_| -9.0);
        assert!(system.solve().is_none());
    }

    #[test]
    fn nothing_to_solve_is_solved() {
        let mut system = BlockSystem::<6>::new(0, []).unwrap();
        system.damp(|_| 0.0);
        assert_eq!(system.solve(), Some(Vec::new()));
    }
}
