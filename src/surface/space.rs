//! The patient's axes in which a mesh file gives its nodes.

use crate::{Error, Result};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The directions of x and y in a mesh file. Recordings and surfaces in memory are in [`Space::Ras`].
///
/// 3D Slicer takes mesh files that do not say as LPS, OpenIGTLink's data as RAS. Files written here say which they are, the
/// way Slicer does: `SPACE=RAS` in STL's header and in comments of PLY and OBJ, the field `SPACE` of VTP, `space` in
/// MAT-files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Space {
    /// x to the patient's right, y to the front, z to the head: the tracker's own axes, unchanged.
    #[default]
    Ras,
    /// x to the left, y to the back, z to the head, as DICOM has them: x and y change their signs.
    Lps,
}

impl Space {
    /// The name in files.
    pub(super) fn name(self) -> &'static str {
        match self {
            Space::Ras => "RAS",
            Space::Lps => "LPS",
        }
    }

    /// The space of that name, in capitals or not.
    pub(super) fn named(name: &str) -> Option<Self> {
        [Space::Ras, Space::Lps].into_iter().find(|space| space.name().eq_ignore_ascii_case(name.trim()))
    }

    /// A point of this space in RAS, and the other way round.
    pub(crate) fn swapped(self, p: DVec3) -> DVec3 {
        match self {
            Space::Ras => p,
            Space::Lps => DVec3::new(-p.x, -p.y, p.z),
        }
    }

    /// What a text such as a comment says: `SPACE=LPS` among other words.
    pub(super) fn marked(text: &str) -> Option<Self> {
        let at = text.to_ascii_uppercase().find(MARK)? + MARK.len();
        Self::named(text.get(at..at + 3)?)
    }
}

/// What stands before the name in comments.
const MARK: &str = "SPACE=";

impl FromStr for Space {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::named(name).ok_or_else(|| Error::setting("space", format!("{name:?}"), "ras or lps"))
    }
}

impl fmt::Display for Space {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_space_is_found_among_other_words() {
        for (text, space) in [
            ("3D Slicer output. SPACE=RAS", Some(Space::Ras)),
            ("comment space=lps", Some(Space::Lps)),
            ("SPACE=", None),
            ("SPACE=RA", None),
            ("SPACE=XYZ", None),
            ("µ SPACE=LPS, mm", Some(Space::Lps)),
            ("in outer space", None),
        ] {
            assert_eq!(Space::marked(text), space, "{text}");
        }
        assert_eq!(Space::Lps.swapped(DVec3::new(1.0, -2.0, 3.0)), DVec3::new(-1.0, 2.0, 3.0));
    }
}
