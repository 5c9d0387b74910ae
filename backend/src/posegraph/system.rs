//! The sparse normal equations: 7×7 blocks in a fixed pattern, factorised by Cholesky.

use super::PoseGraphError;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{LltRef, SymbolicCholesky, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side, Spec};
use nalgebra::{SMatrix, SVector};

const DIM: usize = 7;

/// `H δ = −g` over the free nodes; the lower triangle of H in compressed columns.
///
/// The pattern and its symbolic factorisation are made once; values are refilled each iteration.
pub(super) struct NormalEquations {
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    damped: Vec<f64>,
    factor: Vec<f64>,
    gradient: Vec<f64>,
    buffer: MemBuffer,
}

/// Where the off-diagonal block of a pair of free nodes lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockSlot {
    column: usize,
    position: usize,
}

impl NormalEquations {
    /// The system of `free_nodes` nodes coupled by `pairs` (each `(greater, smaller)` index), and
    /// the slot of each pair.
    pub(super) fn new(
        free_nodes: usize,
        pairs: &[(usize, usize)],
    ) -> Result<(Self, Vec<BlockSlot>), PoseGraphError> {
        let mut rows: Vec<Vec<usize>> = (0..free_nodes).map(|node| vec![node]).collect();
        for &(greater, smaller) in pairs {
            rows[smaller].push(greater);
        }
        for column in &mut rows {
            column.sort_unstable();
            column.dedup();
        }
        let slot = |&(greater, column): &(usize, usize)| BlockSlot {
            column,
            position: rows[column].partition_point(|&row| row < greater),
        };
        let slots = pairs.iter().map(slot).collect();

        let (column_starts, row_indices) = expand_blocks(&rows);
        let size = free_nodes * DIM;
        let nonzeros = row_indices.len();
        let pattern = SymbolicSparseColMat::new_checked(size, size, column_starts, None, row_indices);
        let failed = |reason: String| PoseGraphError::Solver { nodes: free_nodes, reason };
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
        let system = Self {
            values: vec![0.0; nonzeros],
            damped: vec![0.0; nonzeros],
            factor: vec![0.0; symbolic.len_val()],
            gradient: vec![0.0; size],
            pattern,
            symbolic,
            buffer,
        };
        Ok((system, slots))
    }

    /// Sets H and g to zero.
    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradient.fill(0.0);
    }

    /// Adds a node's own block and gradient.
    pub(super) fn add_node(
        &mut self,
        node: usize,
        block: &SMatrix<f64, DIM, DIM>,
        gradient: &SVector<f64, DIM>,
    ) {
        for c in 0..DIM {
            let start = self.pattern.col_ptr()[node * DIM + c];
            for r in c..DIM {
                self.values[start + r - c] += block[(r, c)];
            }
            self.gradient[node * DIM + c] += gradient[c];
        }
    }

    /// Adds the block of a pair, rows of the greater node, columns of the smaller.
    pub(super) fn add_pair(&mut self, slot: BlockSlot, block: &SMatrix<f64, DIM, DIM>) {
        for c in 0..DIM {
            // The diagonal block of scalar column c holds only its DIM − c lower entries.
            let column_start = self.pattern.col_ptr()[slot.column * DIM + c];
            let start = column_start + DIM - c + DIM * (slot.position - 1);
            for r in 0..DIM {
                self.values[start + r] += block[(r, c)];
            }
        }
    }

    /// The step `δ = −(H + damping·diag(H))⁻¹ g` and the decrease `−gᵀδ − ½ δᵀHδ` that it promises
    /// of half the cost; `None` when the damped matrix is not positive definite.
    pub(super) fn solve(&mut self, damping: f64) -> Option<(Vec<f64>, f64)> {
        self.damped.copy_from_slice(&self.values);
        let starts = &self.pattern.col_ptr()[..self.gradient.len()];
        let largest = starts.iter().map(|&start| self.values[start]).fold(0.0, f64::max);
        // A floor keeps nodes without edges, and free gauges, solvable: they do not move.
        let floor = 1e-12 * largest.max(f64::MIN_POSITIVE);
        let added = |diagonal: f64| damping * diagonal + floor;
        for &start in starts {
            self.damped[start] += added(self.values[start]);
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
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let size = step.len();
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(&mut step, size, 1),
            Par::Seq,
            stack,
        );
        if step.iter().any(|v| !v.is_finite()) {
            return None;
        }
        // With (H + D) δ = −g the promise −gᵀδ − ½ δᵀHδ becomes ½ (δᵀDδ − gᵀδ).
        let promised: f64 = step
            .iter()
            .zip(&self.gradient)
            .zip(starts)
            .map(|((d, g), &start)| 0.5 * (added(self.values[start]) * d * d - g * d))
            .sum();
        Some((step, promised))
    }
}

/// Scalar compressed columns of the lower triangle of a block pattern whose columns begin with
/// their diagonal block.
fn expand_blocks(block_rows: &[Vec<usize>]) -> (Vec<usize>, Vec<usize>) {
    let mut starts = vec![0];
    let mut rows = Vec::new();
    for (node, column) in block_rows.iter().enumerate() {
        for c in 0..DIM {
            rows.extend(node * DIM + c..(node + 1) * DIM);
            for &row in &column[1..] {
                rows.extend(row * DIM..(row + 1) * DIM);
            }
            starts.push(rows.len());
        }
    }
    (starts, rows)
}
