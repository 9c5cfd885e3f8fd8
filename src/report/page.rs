//! An HTML page: one file that contains its style, plots and pictures and needs no network. Without scripts,
//! all but the vessel to turn is there.

use super::render::{Style, render};
use super::viewer::embedded_page;
use crate::Result;
use crate::geometry::Pose;
use crate::recording::Recording;
use crate::surface::Surface;
use base64::Engine as _;
use std::fmt::Write as _;

/// A table, for a page or a terminal.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Its title.
    pub title: String,
    /// The heads of its columns.
    pub head: Vec<String>,
    /// Its cells, row by row.
    pub rows: Vec<Vec<String>>,
    /// Explanation of the numbers.
    pub note: String,
}

impl std::fmt::Display for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let width = |column: usize| {
            let cells = self.rows.iter().chain([&self.head]).filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        writeln!(f, "{}", self.title)?;
        for row in [&self.head].into_iter().chain(&self.rows) {
            let mut line = String::from(" ");
            for (column, cell) in row.iter().enumerate() {
                let room = width(column);
                // Names to the left, numbers to the right.
                if column == 0 { write!(line, " {cell:<room$}")? } else { write!(line, "  {cell:>room$}")? }
            }
            writeln!(f, "{}", line.trim_end())?;
        }
        if !self.note.is_empty() {
            writeln!(f, "  {}", self.note)?;
        }
        Ok(())
    }
}

/// A page under construction.
pub(super) struct Page {
    title: String,
    body: String,
}

impl Page {
    pub fn new(title: &str) -> Self {
        Self { title: escaped(title), body: String::new() }
    }

    pub fn heading(&mut self, text: &str) -> &mut Self {
        self.push("h2", text)
    }

    pub fn paragraph(&mut self, text: &str) -> &mut Self {
        self.push("p", text)
    }

    /// Preformatted text.
    pub fn listing(&mut self, text: &str) -> &mut Self {
        self.push("pre", text)
    }

    pub fn table(&mut self, table: &Table) -> &mut Self {
        let row = |cells: &[String], tag: &str| {
            let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows: String = table.rows.iter().map(|cells| row(cells, "td")).collect();
        let head =
            if table.head.iter().all(String::is_empty) { String::new() } else { row(&table.head, "th") };
        let caption = match table.title.as_str() {
            "" => String::new(),
            title => format!("<caption>{}</caption>\n", escaped(title)),
        };
        // Sentences in the last column need room.
        let is_long =
            |cells: &Vec<String>| cells.last().is_some_and(|cell| cell.contains(". ") || cell.ends_with('.'));
        let class = if table.rows.iter().any(is_long) { " class=\"why\"" } else { "" };
        self.body += &format!("<div class=\"block\"><table{class}>\n{caption}{head}{rows}</table>\n");
        if !table.note.is_empty() {
            self.push("p class=\"note\"", &table.note);
        }
        self.body += "</div>\n";
        self
    }

    /// Terms and their definitions.
    pub fn definitions<'a>(&mut self, terms: impl IntoIterator<Item = (&'a str, &'a str)>) -> &mut Self {
        self.body += "<dl>\n";
        for (term, meaning) in terms {
            self.push("dt", term).push("dd", meaning);
        }
        self.body += "</dl>\n";
        self
    }

    /// A plot as SVG text, with a caption.
    pub fn plot(&mut self, svg: &str, caption: &str) -> &mut Self {
        // Narrower where the page is, but never larger than it was drawn.
        let width = svg.split('"').nth(1).unwrap_or_default();
        let svg = svg.split_once(" viewBox").map_or_else(
            || svg.into(),
            |(_, rest)| format!("<svg style=\"max-width: {width}px\" viewBox{rest}"),
        );
        self.figure(&svg, caption)
    }

    /// Both plots side by side.
    pub fn plots(&mut self, plots: [(&str, &str); 2]) -> &mut Self {
        self.body += "<div class=\"pair\">\n";
        for (svg, caption) in plots {
            self.plot(svg, caption);
        }
        self.body += "</div>\n";
        self
    }

    /// A mesh from three sides.
    pub fn mesh(&mut self, surface: &Surface, style: &Style, caption: &str) -> Result<&mut Self> {
        let png = render(surface, style)?.png()?;
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        let alt = escaped(caption);
        Ok(self.figure(&format!("<img alt=\"{alt}\" src=\"data:image/png;base64,{data}\">"), caption))
    }

    /// The same mesh to turn and measure, as a page within this one; on paper the pictures remain. A mesh that
    /// would make the page too large is left to `lumenmesh view`.
    pub fn viewer(
        &mut self,
        name: &str,
        surface: &Surface,
        recording: Option<(&Recording, Pose)>,
    ) -> &mut Self {
        const MOST_NODES: usize = 100_000;
        if surface.nodes_mm.len() > MOST_NODES {
            let nodes = surface.nodes_mm.len();
            return self.paragraph(&format!(
                "The mesh has {nodes} nodes, too many to be turned within this page: lumenmesh view shows it."
            ));
        }
        let page = escaped(&embedded_page(name, surface, recording));
        // Scripts of that page only: they reach neither this page nor a network.
        self.body += &format!(
            "<figure class=\"screen\">\n<iframe title=\"{0}\" sandbox=\"allow-scripts allow-downloads\" loading=\"lazy\" \
             srcdoc=\"{page}\"></iframe>\n<figcaption>{0} to turn, clip, fly through and measure; ? lists the keys.\
             </figcaption>\n</figure>\n",
            escaped(name)
        );
        self
    }

    pub fn finish(self) -> String {
        let Self { title, body } = self;
        let version = env!("CARGO_PKG_VERSION");
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
             content=\"width=device-width\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
             <h1>{title}</h1>\n{body}<footer>lumenmesh {version}. Lengths in mm. Not for clinical use.</footer>\n\
             </body>\n</html>\n"
        )
    }

    fn figure(&mut self, content: &str, caption: &str) -> &mut Self {
        self.body +=
            &format!("<figure>\n{content}\n<figcaption>{}</figcaption>\n</figure>\n", escaped(caption));
        self
    }

    fn push(&mut self, tag: &str, text: &str) -> &mut Self {
        let end = tag.split(' ').next().unwrap_or(tag);
        self.body += &format!("<{tag}>{}</{end}>\n", escaped(text));
        self
    }
}

const STYLE: &str = "\
body { font: 16px/1.5 system-ui, sans-serif; color: #26262b; background: #fff; max-width: 62rem; margin: 2rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.25; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #ccc; padding-bottom: .2rem; }
p { max-width: 48rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .8rem 0 .2rem; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .2rem .9rem .2rem 0; text-align: right; border-bottom: 1px solid #e2e2e2; vertical-align: top; }
th { font-weight: 600; border-bottom-color: #888; }
th:first-child, td:first-child { text-align: left; white-space: nowrap; }
.why th:last-child, .why td:last-child { text-align: left; min-width: 12rem; font-size: .85rem; padding-right: 0; }
.why th, .why td { padding-right: .6rem; }
dt { font-weight: 600; } dd { margin: 0 0 .5rem 1.2rem; max-width: 46rem; }
.note, figcaption { color: #55555c; font-size: .9rem; margin: .3rem 0 1.2rem; }
figure { margin: 1rem 0; }
figure svg, figure img { display: block; width: 100%; height: auto; }
figure img { border: 1px solid #e2e2e2; }
iframe { display: block; width: 100%; height: 36rem; border: 1px solid #e2e2e2; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1.2rem; }
.pair figure { margin: .6rem 0; }
pre { background: #f6f6f4; padding: .7rem 1rem; overflow-x: auto; font-size: .85rem; line-height: 1.4; white-space: pre-wrap; }
footer { color: #55555c; font-size: .85rem; margin: 2.5rem 0 1rem; border-top: 1px solid #ccc; padding-top: .5rem; }
@media print {
  body { margin: 0; max-width: none; font-size: 10pt; }
  th, td { padding-right: .6rem; }
  figure, .block, pre { break-inside: avoid; }
  .screen { display: none; }
  h2 { break-after: avoid; }
}
";

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Frame;
    use glam::{DVec2, DVec3};

    #[test]
    fn what_is_typed_is_no_markup() {
        let mut page = Page::new("a <b> & c");
        page.paragraph("1 < 2").listing("\"x\"");
        let html = page.finish();
        assert!(html.contains("<title>a &lt;b&gt; &amp; c</title>"));
        assert!(html.contains("<p>1 &lt; 2</p>") && html.contains("<pre>&quot;x&quot;</pre>"));
    }

    #[test]
    fn a_vessel_within_a_page_is_one_attribute() {
        let mut surface = Surface {
            nodes_mm: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
            arrays: Vec::new(),
        };
        let frame =
            Frame::new(Pose { translation_mm: DVec3::splat(1.0 / 3.0), ..Pose::IDENTITY }, vec![DVec2::X]);
        let recording = Recording { frames: vec![frame] };
        let html = |surface: &Surface| {
            let mut page = Page::new("report");
            page.viewer("a \"vessel\"", surface, Some((&recording, Pose::IDENTITY)));
            page.finish()
        };
        let page = html(&surface);
        let inner = page.split(" srcdoc=\"").nth(1).unwrap().split_once('"').unwrap().0;
        assert!(inner.starts_with("&lt;!DOCTYPE html&gt;") && inner.ends_with("&lt;/html&gt;\n"));
        assert!(
            inner.contains("0.3333]") && !inner.contains("0.33333") && !inner.contains("contour_mm&quot;:")
        );
        assert!(page.contains("sandbox=\"allow-scripts allow-downloads\"") && page.len() < 200_000);
        surface.nodes_mm.resize(100_001, DVec3::ZERO);
        let page = html(&surface);
        assert!(page.contains("100001 nodes, too many") && !page.contains("<iframe"));
    }

    #[test]
    fn a_table_lines_up_in_a_terminal() {
        let table = Table {
            title: "Heights".into(),
            head: ["", "mm"].map(String::from).to_vec(),
            rows: vec![
                ["low", "1.0"].map(String::from).to_vec(),
                ["middle", "10.0"].map(String::from).to_vec(),
            ],
            note: "A note.".into(),
        };
        assert_eq!(table.to_string(), "Heights\n            mm\n  low      1.0\n  middle  10.0\n  A note.\n");
    }
}
