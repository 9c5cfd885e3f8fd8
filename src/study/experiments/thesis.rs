//! What the thesis prints, number by number. Lengths in mm.

use serde::Serialize;

/// Every number that the thesis prints in its results.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Thesis {
    /// Table 1: the larger cylinder, iterations 0 to 3.
    pub table_1_mm: [f64; 4],
    /// Tables 2 and 3: the frustum, iterations 0 to 10; Table 2 has the first four.
    pub tables_2_and_3_mm: [f64; 11],
    /// Table 4: median over the single cylinders, iterations 0 to 3.
    pub table_4_median_mm: Both<[f64; 4]>,
    /// Table 5: mean over all cylinders that are not merged.
    pub table_5_not_merged_mm: Both<f64>,
    /// Table 5: all cylinders merged.
    pub table_5_merged_mm: Both<f64>,
    /// Tables 6 (noisy) and 7 (noiseless), Figures 33 and 34: the violins' numbers.
    pub tables_6_and_7: Both<ViolinNumbers>,
    /// Text about Figures 35 (noisy) and 36 (noiseless): "overall fitting error" of the colour maps.
    pub figures_35_and_36_overall_mm: Both<f64>,
    /// What the thesis says about its figures.
    pub statements: [Statement; 5],
}

/// A result with noise and without.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Both<T> {
    /// Of the noisy recording.
    pub noisy: T,
    /// Of the noiseless recording.
    pub noiseless: T,
}

/// What the thesis gives of a violin. Quartiles follow from the limits, Q1 - 1.5 IQR and Q3 + 1.5 IQR.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ViolinNumbers {
    /// Mean.
    pub mean_mm: f64,
    /// Third less first quartile.
    pub iqr_mm: f64,
    /// Q1 - 1.5 IQR.
    pub lower_limit_mm: f64,
    /// Q3 + 1.5 IQR.
    pub upper_limit_mm: f64,
}

/// What the thesis says about a figure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Statement {
    /// The figure.
    pub figure: &'static str,
    /// What it shows there.
    pub says: &'static str,
}

/// The thesis's numbers.
pub const THESIS: Thesis = Thesis {
    table_1_mm: [20.0039, 4.92e-16, 4.92e-16, 4.92e-16],
    tables_2_and_3_mm: [
        4.9406, 0.5180, 0.0869, 0.0751, 0.0585, 0.0465, 0.0390, 0.0326, 0.0283, 0.0248, 0.0224,
    ],
    table_4_median_mm: Both {
        noisy: [0.6503, 0.4774, 0.4646, 0.4722],
        noiseless: [0.6381, 0.4716, 0.4555, 0.4572],
    },
    table_5_not_merged_mm: Both { noisy: 0.5187, noiseless: 0.4960 },
    table_5_merged_mm: Both { noisy: 0.4894, noiseless: 0.4588 },
    tables_6_and_7: Both {
        noisy: ViolinNumbers {
            mean_mm: 0.3992,
            iqr_mm: 0.1085,
            lower_limit_mm: 0.1662,
            upper_limit_mm: 0.6001,
        },
        noiseless: ViolinNumbers {
            mean_mm: 0.4007,
            iqr_mm: 0.1060,
            lower_limit_mm: 0.1547,
            upper_limit_mm: 0.5786,
        },
    },
    figures_35_and_36_overall_mm: Both { noisy: 0.2722, noiseless: 0.1643 },
    statements: [
        Statement {
            figure: "Figure 29",
            says: "Errors of the single cylinders peak at the same cylinders with noise and without; at number 120 both have \
                   the same height.",
        },
        Statement {
            figure: "Figures 30 and 31",
            says: "The error of the growing mesh is lower deformed than original throughout; both rise slowly, with peaks.",
        },
        Statement {
            figure: "Figure 32",
            says: "The deformed mesh without noise has the lower error, but for cylinders 102 to 116.",
        },
        Statement { figure: "Figures 33 and 34", says: "Both violins end at Q1 - 1.5 IQR and Q3 + 1.5 IQR." },
        Statement {
            figure: "Figures 35 and 36",
            says: "The error is even over the mesh but near the final edge and the arch; values above 10 times the mean are set \
                   to that.",
        },
    ],
};

/// Why our numbers differ from these.
pub const WHAT_DIFFERS: &str = "The thesis's vessels come from patients and are not public, so that ours are different ones. \
    Insertion and noise follow its description, with our choice where it is silent, and the local cylinders come from \
    another estimator. The thesis defines \"fitting error\" nowhere, and its conclusion calls the medians of Table 4 means. \
    Compare trends within a row, not single values.";
