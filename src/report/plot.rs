//! Plots as SVG, drawn by `plotters`: axes with units, a legend above the plot where nothing can lie under it, and
//! colours that colour-blind readers can tell apart (Okabe and Ito, 2008), each with a dash of its own for print.

use crate::{Error, Result};
use plotters::coord::ranged1d::BoldPoints;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;

/// One set of points of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Its name in the legend.
    pub name: String,
    /// Points (x, y), in the order in which they are joined; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
    /// The marks.
    pub mark: Mark,
}

/// How points are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Joined by a line.
    Line,
    /// As dots.
    Dots,
    /// Joined by a line with dots.
    Both,
}

/// One group of numbers, shown as the outline of their density.
#[derive(Debug, Clone, PartialEq)]
pub struct Violin {
    /// The text below it; `\n` starts a new line.
    pub name: String,
    /// The numbers; those that are not finite are left out.
    pub values: Vec<f64>,
}

/// The width of a plot on its page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Room {
    /// The whole width.
    Whole,
    /// Half of it, beside another plot.
    Half,
}

impl Room {
    /// Pixels across and down, and marks along x.
    fn size(self) -> (u32, u32, usize) {
        match self {
            Room::Whole => (800, 380, 11),
            Room::Half => (500, 320, 6),
        }
    }
}

const LEGEND: i32 = 34;
const LEFT: i32 = 74;
const BOTTOM: i32 = 58;
const INK: RGBColor = RGBColor(38, 38, 43);
const GRID: RGBColor = RGBColor(222, 222, 222);
/// Blue, vermilion, bluish green, reddish purple, orange, sky blue (Okabe and Ito).
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
/// Lengths of dash and gap, pixels; a gap of 0 is a solid line.
const DASHES: [[i32; 2]; 4] = [[1, 0], [9, 4], [3, 3], [14, 3]];
/// Of an entry of the legend: length of its line, room beside it, and width of a letter in heights of the font. Where many
/// entries would not fit, they are narrower.
const WIDE: (i32, i32, f64) = (34, 30, 0.56);
const NARROW: (i32, i32, f64) = (24, 18, 0.5);
const TEXT_PX: i32 = 17;
const Y_MARKS: usize = 7;

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type PlotResult = std::result::Result<(), Box<dyn std::error::Error>>;

/// Lines or dots over two axes. The y axis starts at 0 where no value is negative.
///
/// # Errors
/// [`Error::Setting`] where no point is finite.
pub fn lines(room: Room, x_label: &str, y_label: &str, lines: &[Line]) -> Result<String> {
    let finite = |line: &Line| {
        let points = line.points.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
        points.map(|&[x, y]| (x, y)).collect::<Vec<_>>()
    };
    let lines: Vec<(&Line, Vec<(f64, f64)>)> = lines.iter().map(|line| (line, finite(line))).collect();
    let all = || lines.iter().flat_map(|(_, points)| points.iter());
    let (Some(x), Some(y)) = (range(all().map(|p| p.0)), range(all().map(|p| p.1))) else {
        return Err(nothing_to_draw());
    };
    let y = from_zero(y);
    let (.., max_marks) = room.size();
    // Whole numbers are counts: no marks between them.
    let whole = all().all(|p| p.0.fract() == 0.0);
    let marks = if whole { max_marks.min((x.end - x.start) as usize + 1) } else { max_marks };
    // Dashes would hide the course of a line through many points.
    let dense = lines.iter().any(|(_, points)| points.len() > 60);
    let dashes = |i: usize| if dense { DASHES[0] } else { DASHES[i % DASHES.len()] };
    svg(room, |root| {
        let mut chart = axes(root, wider(x, 0.02), y, x_label, y_label, marks, lines.len() > 1)?;
        if lines.len() > 1 {
            legend(root, lines.iter().map(|(line, _)| *line), &dashes)?;
        }
        for (i, (line, points)) in lines.iter().enumerate() {
            let style = colour(i).stroke_width(if dense { 1 } else { 2 });
            if line.mark != Mark::Dots {
                match dashes(i) {
                    [_, 0] => drop(chart.draw_series(LineSeries::new(points.iter().copied(), style))?),
                    [dash, gap] => drop(chart.draw_series(DashedLineSeries::new(
                        points.iter().copied(),
                        dash as u32,
                        gap as u32,
                        style,
                    ))?),
                }
            }
            if line.mark != Mark::Line {
                chart.draw_series(points.iter().map(|&p| Circle::new(p, 4, colour(i).filled())))?;
            }
        }
        Ok(())
    })
}

/// Groups of numbers side by side: outlines of their densities (Gaussian kernel, Silverman's width), all of one
/// width, with a bar from the first to the third quartile and a dot at the median. The axis ends at the largest 99th
/// percentile; what lies above is cut off.
///
/// # Errors
/// [`Error::Setting`] where a group has no finite number.
pub fn violins(y_label: &str, violins: &[Violin]) -> Result<String> {
    let sorted: Vec<Vec<f64>> = violins
        .iter()
        .map(|violin| {
            let mut values: Vec<f64> = violin.values.iter().copied().filter(|v| v.is_finite()).collect();
            values.sort_unstable_by(f64::total_cmp);
            values
        })
        .collect();
    if sorted.is_empty() || sorted.iter().any(Vec::is_empty) {
        return Err(nothing_to_draw());
    }
    let tops = sorted.iter().map(|values| at_share(values, 0.99));
    let lows = sorted.iter().map(|values| values[0]);
    let y = range(tops.chain(lows)).map_or(0.0..1.0, from_zero);
    svg(Room::Whole, |root| {
        let x = 0.0..violins.len() as f64;
        let mut chart = axes(root, x, y.clone(), "", y_label, 0, false)?;
        for (i, (violin, values)) in violins.iter().zip(&sorted).enumerate() {
            let middle = i as f64 + 0.5;
            let half = (0.14 * violins.len() as f64).min(0.42);
            let outline = density(values, &y);
            let left = outline.iter().map(|&(v, width)| (middle - half * width, v));
            let right = outline.iter().rev().map(|&(v, width)| (middle + half * width, v));
            let outline: Vec<(f64, f64)> = left.chain(right).collect();
            chart.draw_series([Polygon::new(outline.clone(), colour(i).mix(0.35).filled())])?;
            let closed = outline.iter().chain(outline.first()).copied().collect::<Vec<_>>();
            chart.draw_series([PathElement::new(closed, colour(i).stroke_width(1))])?;
            let bar = [0.25, 0.75].map(|share| (middle, at_share(values, share).min(y.end)));
            chart.draw_series([PathElement::new(bar.to_vec(), INK.stroke_width(5))])?;
            let median = (middle, at_share(values, 0.5).min(y.end));
            chart.draw_series([Circle::new(median, 4, WHITE.filled())])?;
            chart.draw_series([Circle::new(median, 4, INK.stroke_width(1))])?;
            let (x_px, y_px) = chart.backend_coord(&(middle, y.start));
            for (row, text) in violin.name.lines().enumerate() {
                let at = (x_px, y_px + 8 + row as i32 * (TEXT_PX + 3));
                root.draw(&Text::new(text.to_owned(), at, text_style(HPos::Center, VPos::Top)))?;
            }
        }
        Ok(())
    })
}

fn svg(room: Room, draw: impl FnOnce(&Area) -> PlotResult) -> Result<String> {
    let mut text = String::new();
    let (width, height, _) = room.size();
    let drawn = {
        let root = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
        let drawn = root.fill(&WHITE).map_err(Into::into).and_then(|()| draw(&root));
        drawn.and_then(|()| Ok(root.present()?))
    };
    match drawn {
        Ok(()) => Ok(text),
        Err(error) => {
            let source = std::io::Error::other(error.to_string());
            Err(Error::Output { target: "figure", source })
        }
    }
}

/// The axes, with room for a legend above them if asked for. `x_marks` 0: no marks along x.
fn axes<'a, 'b>(
    root: &'a Area<'b>,
    x: Range<f64>,
    y: Range<f64>,
    x_label: &str,
    y_label: &str,
    x_marks: usize,
    with_legend: bool,
) -> std::result::Result<Chart<'a, 'b>, Box<dyn std::error::Error>> {
    let mut chart = ChartBuilder::on(root)
        .margin_top(if with_legend { 12 + LEGEND } else { 12 })
        .margin_right(22)
        .margin_left(4)
        .margin_bottom(4)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LEFT)
        .build_cartesian_2d(x.clone(), y.clone())?;
    let (x_step, y_step) = (step(&x, x_marks), step(&y, Y_MARKS));
    let x_format = |v: &f64| super::render::label(*v, x_step);
    let y_format = |v: &f64| super::render::label(*v, y_step);
    let text = text_style(HPos::Left, VPos::Top);
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(INK)
        .y_labels(Y_MARKS)
        .x_labels(x_marks)
        .x_label_formatter(&x_format)
        .y_label_formatter(&y_format)
        .label_style(text.clone())
        .axis_desc_style(text)
        .y_desc(y_label);
    if x_marks > 0 {
        mesh.x_desc(x_label);
    }
    mesh.draw()?;
    Ok(chart)
}

/// The legend above the plot.
fn legend<'a>(
    root: &Area,
    lines: impl Iterator<Item = &'a Line> + Clone,
    dashes: &dyn Fn(usize) -> [i32; 2],
) -> PlotResult {
    const Y: i32 = 22;
    let width = |line: &Line, (length, room, letter): (i32, i32, f64)| {
        length + room + (line.name.chars().count() as f64 * letter * f64::from(TEXT_PX)) as i32
    };
    let mut left = LEFT + 8;
    let whole: i32 = lines.clone().map(|line| width(line, WIDE)).sum();
    let size = if left + whole <= root.dim_in_pixel().0 as i32 { WIDE } else { NARROW };
    let (length, ..) = size;
    for (i, line) in lines.enumerate() {
        let [dash, gap] = dashes(i);
        let dash = if gap == 0 { length } else { dash };
        if line.mark != Mark::Dots {
            for start in (0..length).step_by((dash + gap) as usize) {
                let ends = vec![(left + start, Y), (left + (start + dash).min(length), Y)];
                root.draw(&PathElement::new(ends, colour(i).stroke_width(3)))?;
            }
        }
        if line.mark != Mark::Line {
            root.draw(&Circle::new((left + length / 2, Y), 4, colour(i).filled()))?;
        }
        let style = text_style(HPos::Left, VPos::Center);
        root.draw(&Text::new(line.name.clone(), (left + length + 7, Y), style))?;
        left += width(line, size);
    }
    Ok(())
}

fn text_style(h: HPos, v: VPos) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", TEXT_PX)).color(&INK).pos(Pos::new(h, v))
}

fn colour(i: usize) -> RGBColor {
    COLOURS[i % COLOURS.len()]
}

/// The distance between the marks that `plotters` sets on an axis.
fn step(range: &Range<f64>, most: usize) -> f64 {
    let marks = RangedCoordf64::from(range.clone()).key_points(BoldPoints(most));
    marks.windows(2).map(|pair| pair[1] - pair[0]).next().unwrap_or(range.end - range.start)
}

fn range(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let ends = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    (ends.0 <= ends.1).then_some(ends.0..ends.1)
}

/// A little room at both ends, and some where both ends meet.
fn wider(range: Range<f64>, share: f64) -> Range<f64> {
    let room = (range.end - range.start) * share;
    let room = if room > 0.0 { room } else { range.start.abs().max(1.0) * 0.5 };
    range.start - room..range.end + room
}

fn from_zero(range: Range<f64>) -> Range<f64> {
    if range.start < 0.0 {
        return wider(range, 0.05);
    }
    0.0..if range.end > 0.0 { range.end * 1.06 } else { 1.0 }
}

/// Of sorted numbers, by nearest rank.
fn at_share(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

/// The outline of a violin: values and widths, the widest 1.
fn density(sorted: &[f64], y: &Range<f64>) -> Vec<(f64, f64)> {
    let n = sorted.len() as f64;
    let mean = sorted.iter().sum::<f64>() / n;
    let sd = (sorted.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    let quartiles = (at_share(sorted, 0.75) - at_share(sorted, 0.25)) / 1.34;
    let spread = if quartiles > 0.0 { sd.min(quartiles) } else { sd };
    // Equal numbers have no density of their own: a hair of the axis stands for one.
    let width = (0.9 * spread * n.powf(-0.2)).max(1e-3 * (y.end - y.start));
    let (low, high) = (sorted[0].max(y.start), sorted[sorted.len() - 1].min(y.end));
    const STEPS: usize = 120;
    let heights: Vec<(f64, f64)> = (0..=STEPS)
        .map(|i| {
            let v = low + (high - low) * i as f64 / STEPS as f64;
            let first = sorted.partition_point(|s| *s < v - 4.0 * width);
            let near = sorted[first..].iter().take_while(|s| **s <= v + 4.0 * width);
            (v, near.map(|s| (-0.5 * ((v - s) / width).powi(2)).exp()).sum())
        })
        .collect();
    let most = heights.iter().map(|h| h.1).fold(f64::MIN_POSITIVE, f64::max);
    heights.into_iter().map(|(v, height)| (v, height / most)).collect()
}

fn nothing_to_draw() -> Error {
    Error::Setting {
        name: "figure".into(),
        found: "no finite number".into(),
        expected: "at least one".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(name: &str, points: &[[f64; 2]]) -> Line {
        Line { name: name.into(), points: points.to_vec(), mark: Mark::Both }
    }

    #[test]
    fn a_plot_has_its_labels_and_legend() {
        let two = [line("before", &[[0.0, 1.0], [1.0, 0.5]]), line("after", &[[0.0, 0.8], [1.0, 0.1]])];
        let svg = lines(Room::Half, "iteration", "error (mm)", &two).unwrap();
        for text in ["iteration", "error (mm)", "before", "after"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn odd_numbers_draw_or_are_refused() {
        for points in [vec![[0.0, 0.0]], vec![[3.0, 3.0], [3.0, 3.0]], vec![[f64::NAN, 1.0], [1.0, 1e9]]] {
            assert!(lines(Room::Whole, "x", "y", &[line("a", &points)]).is_ok(), "{points:?}");
        }
        assert!(lines(Room::Whole, "x", "y", &[line("a", &[[f64::NAN, 1.0]])]).is_err());
        let violin = |values: &[f64]| violins("y", &[Violin { name: "a".into(), values: values.to_vec() }]);
        for values in [&[0.0][..], &[2.0, 2.0], &[-1.0, f64::INFINITY, 1e-9]] {
            assert!(violin(values).is_ok(), "{values:?}");
        }
        assert!(violin(&[]).is_err());
    }

    #[test]
    fn a_violin_is_widest_where_most_numbers_are() {
        let values: Vec<f64> =
            (0..100).map(|i| if i < 90 { 1.0 + f64::from(i) * 1e-3 } else { 3.0 }).collect();
        let widest = density(&values, &(0.0..3.5)).into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((widest.0 - 1.045).abs() < 0.05, "{widest:?}");
    }
}
