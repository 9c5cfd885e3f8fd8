//! Symmetric systems with few diagonals, as penalties on second differences make them.

use std::ops::{AddAssign, Mul, Sub};

/// A symmetric matrix with two diagonals on either side of the main one.
#[derive(Debug, Clone)]
pub(crate) struct Pentadiagonal {
    /// Per row: its own element and those one and two to the right.
    rows: Vec<[f64; 3]>,
}

impl Pentadiagonal {
    /// A matrix of zeros.
    pub(crate) fn zeros(count: usize) -> Self {
        Self { rows: vec![[0.0; 3]; count] }
    }

    /// `weight` times the squares of all second differences.
    pub(crate) fn second_differences(count: usize, weight: f64) -> Self {
        let mut matrix = Self::zeros(count);
        for row in 0..count.saturating_sub(2) {
            matrix.add_bend(row, weight);
        }
        matrix
    }

    /// Adds `weight` times the square of the second difference of rows `row` to `row + 2`.
    pub(crate) fn add_bend(&mut self, row: usize, weight: f64) {
        self.rows[row][0] += weight;
        self.rows[row][1] -= 2.0 * weight;
        self.rows[row][2] += weight;
        self.rows[row + 1][0] += 4.0 * weight;
        self.rows[row + 1][1] -= 2.0 * weight;
        self.rows[row + 2][0] += weight;
    }

    /// Adds `weight` times the square of a combination of rows `row` and `row + 1`.
    pub(crate) fn add_pair(&mut self, row: usize, weight: f64, [a, b]: [f64; 2]) {
        self.rows[row][0] += weight * a * a;
        self.rows[row][1] += weight * a * b;
        self.rows[row + 1][0] += weight * b * b;
    }

    /// Adds to the diagonal.
    pub(crate) fn add_diagonal(&mut self, row: usize, weight: f64) {
        self.rows[row][0] += weight;
    }

    /// `LDLᵀ`; `None` where the matrix is not positive definite.
    pub(crate) fn factored(mut self) -> Option<Factored> {
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
pub(crate) struct Factored {
    /// Per row: 1/D and the elements of Lᵀ one and two to the right.
    rows: Vec<[f64; 3]>,
}

impl Factored {
    /// The solution for one right-hand side.
    pub(crate) fn solve<T>(&self, mut x: Vec<T>) -> Vec<T>
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

/// A symmetric matrix with `width` diagonals on either side of the main one.
#[derive(Debug, Clone)]
pub(crate) struct Banded {
    width: usize,
    /// Row after row: the elements from the lowest diagonal to the main one.
    rows: Vec<f64>,
}

/// The factor L of a [`Banded`] matrix `L Lᵀ`.
#[derive(Debug, Clone)]
pub(crate) struct BandedFactor {
    width: usize,
    /// Row after row: the elements from the lowest diagonal on, and the inverse of the main one's.
    rows: Vec<f64>,
    /// Column after column: the elements below the main diagonal.
    columns: Vec<f64>,
}

impl Banded {
    /// A matrix of zeros.
    pub(crate) fn zeros(count: usize, width: usize) -> Self {
        Self { width, rows: vec![0.0; count * (width + 1)] }
    }

    /// Adds to the element of a row and a column that is not above it.
    pub(crate) fn add(&mut self, row: usize, column: usize, x: f64) {
        self.rows[row * (self.width + 1) + self.width - (row - column)] += x;
    }

    /// Its Cholesky factor, with `floor` times the largest element of the diagonal added to that; `None` where the matrix is
    /// not positive definite.
    pub(crate) fn factored(self, floor: f64) -> Option<BandedFactor> {
        let Self { width, mut rows } = self;
        let stride = width + 1;
        let count = rows.len() / stride;
        let largest = rows.chunks_exact(stride).fold(0.0_f64, |max, row| max.max(row[width]));
        let mut columns = vec![0.0; count * width];
        // Products of row i with each row before it, and with itself last. Every element is multiplied by a column as soon as
        // it is known: sums that do not wait for each other.
        let mut products = vec![0.0; stride];
        for i in 0..count {
            let (before, row) = rows.split_at_mut(i * stride);
            let row = &mut row[..stride];
            row[width] += floor * largest;
            products.fill(0.0);
            for j in i.saturating_sub(width)..i {
                let place = width - (i - j);
                let element = (row[place] - products[place]) * before[j * stride + width];
                row[place] = element;
                let column = &mut columns[j * width..(j + 1) * width];
                let rows_after = products[place + 1..width].iter_mut().zip(&*column);
                rows_after.for_each(|(product, below)| *product += element * below);
                products[width] += element * element;
                column[i - j - 1] = element;
            }
            let rest = row[width] - products[width];
            if !(rest > 0.0 && rest.is_finite()) {
                return None;
            }
            row[width] = rest.sqrt().recip();
        }
        Some(BandedFactor { width, rows, columns })
    }
}

impl BandedFactor {
    /// Solves for one right-hand side, in its place.
    pub(crate) fn solve(&self, x: &mut [f64]) {
        let (width, stride, count) = (self.width, self.width + 1, x.len());
        // By columns, so that no sum waits for its last product.
        let mut products = vec![0.0; count + width];
        for (i, column) in (0..count).zip(self.columns.chunks_exact(width)) {
            x[i] = (x[i] - products[i]) * self.rows[i * stride + width];
            let below = &mut products[i + 1..=i + width];
            below.iter_mut().zip(column).for_each(|(product, l)| *product += l * x[i]);
        }
        for i in (0..count).rev() {
            let first = i.saturating_sub(width);
            let row = &self.rows[i * stride..(i + 1) * stride];
            let here = x[i] * row[width];
            x[i] = here;
            x[first..i].iter_mut().zip(&row[width - (i - first)..width]).for_each(|(x, l)| *x -= here * l);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_banded_system_is_solved() {
        // Rows i have 4 + i on the diagonal and 1, 0.5 and 0.25 beside it.
        let element = |i: usize, j: usize| match i.abs_diff(j) {
            0 => 4.0 + i as f64,
            near @ 1..=3 => 0.5_f64.powi(near as i32 - 1),
            _ => 0.0,
        };
        for count in [1, 2, 3, 4, 9] {
            let mut matrix = Banded::zeros(count, 3);
            (0..count).for_each(|i| (i.saturating_sub(3)..=i).for_each(|j| matrix.add(i, j, element(i, j))));
            let truth: Vec<f64> = (0..count).map(|i| 1.0 - 0.3 * i as f64).collect();
            let product = |i: usize| (0..count).map(|j| element(i, j) * truth[j]).sum();
            let mut x: Vec<f64> = (0..count).map(product).collect();
            matrix.factored(0.0).unwrap().solve(&mut x);
            assert!(x.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-13), "{x:?}");
        }
        let mut indefinite = Banded::zeros(2, 1);
        [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 1.0)].iter().for_each(|&(i, j, x)| indefinite.add(i, j, x));
        assert!(indefinite.factored(0.0).is_none());
    }
}
