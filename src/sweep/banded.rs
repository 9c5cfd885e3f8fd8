//! Symmetric systems with five diagonals.

use std::ops::{AddAssign, Mul, Sub};

/// A symmetric matrix with two diagonals on either side of the main one.
#[derive(Debug, Clone)]
pub(super) struct Pentadiagonal {
    /// Per row: its own element and those one and two to the right.
    rows: Vec<[f64; 3]>,
}

impl Pentadiagonal {
    /// A matrix of zeros.
    pub(super) fn zeros(count: usize) -> Self {
        Self { rows: vec![[0.0; 3]; count] }
    }

    /// `weight` times the squares of all second differences.
    pub(super) fn second_differences(count: usize, weight: f64) -> Self {
        let mut matrix = Self::zeros(count);
        for row in 0..count.saturating_sub(2) {
            matrix.add_bend(row, weight);
        }
        matrix
    }

    /// Adds `weight` times the square of the second difference of rows `row` to `row + 2`.
    pub(super) fn add_bend(&mut self, row: usize, weight: f64) {
        self.rows[row][0] += weight;
        self.rows[row][1] -= 2.0 * weight;
        self.rows[row][2] += weight;
        self.rows[row + 1][0] += 4.0 * weight;
        self.rows[row + 1][1] -= 2.0 * weight;
        self.rows[row + 2][0] += weight;
    }

    /// Adds `weight` times the square of a combination of rows `row` and `row + 1`.
    pub(super) fn add_pair(&mut self, row: usize, weight: f64, [a, b]: [f64; 2]) {
        self.rows[row][0] += weight * a * a;
        self.rows[row][1] += weight * a * b;
        self.rows[row + 1][0] += weight * b * b;
    }

    /// Adds to the diagonal.
    pub(super) fn add_diagonal(&mut self, row: usize, weight: f64) {
        self.rows[row][0] += weight;
    }

    /// `LDLᵀ`; `None` where the matrix is not positive definite.
    pub(super) fn factored(mut self) -> Option<Factored> {
        for i in 0..self.rows.len() {
            let [d, a, b] = self.rows[i];
            if !(d > 0.0 && d.is_finite()) {
                return None;
            }
            let (l1, l2) = (a / d, b / d);
            if let Some(row) = self.rows.get_mut(i + 1) {
                row[0] -= l1 * a;
                row[1] -= l1 * b;
            }
            if let Some(row) = self.rows.get_mut(i + 2) {
                row[0] -= l2 * b;
            }
            self.rows[i] = [d.recip(), l1, l2];
        }
        Some(Factored { rows: self.rows })
    }
}

/// A factored [`Pentadiagonal`].
#[derive(Debug, Clone)]
pub(super) struct Factored {
    /// Per row: 1/D and the elements of Lᵀ one and two to the right.
    rows: Vec<[f64; 3]>,
}

impl Factored {
    /// The solution for one right-hand side.
    pub(super) fn solve<T>(&self, mut x: Vec<T>) -> Vec<T>
    where
        T: Copy + Mul<f64, Output = T> + Sub<Output = T> + AddAssign,
    {
        let count = self.rows.len();
        for i in 0..count {
            let [_, l1, l2] = self.rows[i];
            let here = x[i];
            if i + 1 < count {
                x[i + 1] = x[i + 1] - here * l1;
            }
            if i + 2 < count {
                x[i + 2] = x[i + 2] - here * l2;
            }
        }
        for i in (0..count).rev() {
            let [inverse, l1, l2] = self.rows[i];
            let mut here = x[i] * inverse;
            if i + 1 < count {
                here = here - x[i + 1] * l1;
            }
            if i + 2 < count {
                here = here - x[i + 2] * l2;
            }
            x[i] = here;
        }
        x
    }
}
