//! Transforms by name, and chains of them.

use super::{Sequence, SequenceFrame};
use crate::{Error, Result, text};
use glam::DMat4;
use quick_xml::events::Event;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;

/// What a transform's field ends with.
pub(super) const ENDING: &str = "Transform";
/// What the field of its status ends with.
pub(super) const STATUS_ENDING: &str = "TransformStatus";

/// A transform's name without the ending that its field has.
pub(super) fn without_ending(name: &str) -> &str {
    name.strip_suffix(ENDING).filter(|rest| !rest.is_empty()).unwrap_or(name)
}

/// The coordinate systems of a name such as `ProbeToTracker`: it takes coordinates of the first to those of the second.
fn systems(name: &str) -> Option<(&str, &str)> {
    let split = |(at, _): (usize, &str)| {
        let (from, to) = (&name[..at], &name[at + 2..]);
        (!from.is_empty() && to.starts_with(|c: char| c.is_ascii_uppercase())).then_some((from, to))
    };
    name.match_indices("To").find_map(split)
}

/// Sixteen numbers, row by row.
pub(super) fn matrix(text: &str) -> Option<DMat4> {
    let mut numbers = [0.0; 16];
    let mut words = text.split_ascii_whitespace();
    for number in &mut numbers {
        *number = words.next()?.parse().ok()?;
    }
    words.next().is_none().then(|| DMat4::from_cols_array(&numbers).transpose())
}

/// The transforms of a sequence as a graph: coordinate systems, joined by transforms that lead both ways.
pub(super) struct Graph {
    names: BTreeSet<String>,
    /// Those of a PLUS configuration: the same in all frames.
    constant: BTreeMap<String, DMat4>,
}

impl Graph {
    /// The graph of a sequence, with the constant transforms of a PLUS configuration.
    pub fn of(sequence: &Sequence, plus_config: Option<&Path>) -> Result<Self> {
        let names: BTreeSet<String> = sequence.transform_names().into_iter().map(str::to_owned).collect();
        let mut constant = plus_config.map(plus_transforms).transpose()?.unwrap_or_default();
        // What was measured stands above what the configuration had.
        constant.retain(|name, _| !names.contains(name));
        Ok(Self { names, constant })
    }

    /// The names, for messages.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.names.iter().chain(self.constant.keys()).map(String::as_str).collect();
        names.join(", ")
    }

    /// The shortest chain of transforms and inverses with the meaning of a name; of equally short ones, the first by name.
    pub fn chain(&self, name: &str) -> Option<Chain<'_>> {
        let all = || self.names.iter().chain(self.constant.keys()).map(String::as_str);
        if let Some(name) = all().find(|there| *there == name) {
            return Some(self.steps(&[(name, false)]));
        }
        let (from, to) = systems(name)?;
        let mut reached: BTreeMap<&str, Option<(&str, &str, bool)>> = BTreeMap::from([(from, None)]);
        let mut open = VecDeque::from([from]);
        while let Some(here) = open.pop_front() {
            for edge in all() {
                let Some((start, end)) = systems(edge) else { continue };
                for (inverse, start, end) in [(false, start, end), (true, end, start)] {
                    if start == here && !reached.contains_key(end) {
                        reached.insert(end, Some((here, edge, inverse)));
                        open.push_back(end);
                    }
                }
            }
        }
        let mut steps = Vec::new();
        let mut here = to;
        while let Some((before, edge, inverse)) = *reached.get(here)? {
            steps.push((edge, inverse));
            here = before;
        }
        (!steps.is_empty()).then(|| self.steps(&steps))
    }

    fn steps<'a>(&'a self, steps: &[(&'a str, bool)]) -> Chain<'a> {
        let step = |&(name, inverse)| Step { name, inverse, constant: self.constant.get(name).copied() };
        Chain { steps: steps.iter().map(step).collect() }
    }
}

/// Transforms whose product, in this order, is the one that was asked for.
pub(super) struct Chain<'a> {
    steps: Vec<Step<'a>>,
}

struct Step<'a> {
    name: &'a str,
    inverse: bool,
    constant: Option<DMat4>,
}

impl Chain<'_> {
    /// The product in a frame; `None` where one of the transforms is missing or not OK.
    ///
    /// # Errors
    /// [`Error::Recording`] where a field is no matrix or has no inverse.
    pub fn of(&self, frame: &SequenceFrame) -> Result<Option<DMat4>> {
        let mut product = DMat4::IDENTITY;
        for step in &self.steps {
            let matrix = match (step.constant, frame.transforms.get(step.name)) {
                (Some(constant), _) => constant,
                (None, Some(tracked)) if tracked.is_ok() && tracked.is_there() => {
                    tracked.matrix.ok_or_else(|| Error::Recording {
                        field: "transform",
                        found: format!("{:?} as {}", text::shown(&tracked.text, 60), step.name),
                        expected: "16 numbers".into(),
                    })?
                }
                _ => return Ok(None),
            };
            if step.inverse && matrix.determinant() == 0.0 {
                return Err(Error::Recording {
                    field: "transform",
                    found: format!("{} of determinant 0", step.name),
                    expected: "a matrix with an inverse".into(),
                });
            }
            product *= if step.inverse { matrix.inverse() } else { matrix };
        }
        Ok(Some(product))
    }
}

/// The transforms of a PLUS configuration: `<Transform From="Image" To="Probe" Matrix="…"/>`.
fn plus_transforms(path: &Path) -> Result<BTreeMap<String, DMat4>> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let content = text::decoded(&bytes);
    let xml = |error: &dyn std::fmt::Display| Error::input(path, "XML", error, "well-formed XML");
    let mut reader = quick_xml::Reader::from_str(&content);
    let mut transforms = BTreeMap::new();
    loop {
        match reader.read_event().map_err(|e| xml(&e))? {
            Event::Start(tag) | Event::Empty(tag) if tag.name().as_ref() == "Transform" => {
                let mut values: BTreeMap<String, String> = BTreeMap::new();
                for attribute in tag.attributes() {
                    let attribute = attribute.map_err(|e| xml(&e))?;
                    let name = attribute.key.as_ref().to_owned();
                    let value = attribute.value.into_owned();
                    values.insert(name, value);
                }
                let (Some(from), Some(to), Some(text)) =
                    (values.get("From"), values.get("To"), values.get("Matrix"))
                else {
                    continue;
                };
                let name = format!("{from}To{to}");
                let matrix = matrix(text).ok_or_else(|| {
                    Error::input(path, format!("Matrix of {name}"), format!("{text:?}"), "16 numbers")
                })?;
                transforms.insert(name, matrix);
            }
            Event::Eof => break,
            _ => {}
        }
    }
    if transforms.is_empty() {
        let expected = "<Transform From=\"Image\" To=\"Probe\" Matrix=\"…\"/> in CoordinateDefinitions";
        return Err(Error::input(path, "transforms", "none", expected));
    }
    Ok(transforms)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_split_where_a_capital_follows_to() {
        assert_eq!(systems("ProbeToTracker"), Some(("Probe", "Tracker")));
        assert_eq!(systems("ToolToTracker"), Some(("Tool", "Tracker")));
        assert_eq!(systems("TrackerToTool"), Some(("Tracker", "Tool")));
        assert_eq!(systems("Tool"), None);
        assert_eq!(systems("ToTracker"), None);
    }

    #[test]
    fn a_matrix_has_sixteen_numbers_in_any_spacing() {
        let text = " 1 0 0  2.8e-005 0 1 0 -0 0 0 1 3 0 0 0 1 ";
        assert_eq!(matrix(text).unwrap().w_axis.to_array(), [2.8e-5, 0.0, 3.0, 1.0]);
        assert!(matrix("1 0 0").is_none() && matrix(&format!("{text} 1")).is_none());
    }
}
