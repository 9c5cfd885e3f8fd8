//! Units in the names of columns.

/// A unit: what it measures, and its size in mm, s or rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    quantity: Quantity,
    size: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Length,
    Time,
    Angle,
}

impl Unit {
    /// The unit of that name, in lower case.
    pub fn named(name: &str) -> Option<Self> {
        let (quantity, size) = match name {
            "mm" => (Quantity::Length, 1.0),
            "cm" => (Quantity::Length, 10.0),
            "m" | "metre" | "metres" | "meter" | "meters" => (Quantity::Length, 1000.0),
            "um" | "µm" | "μm" | "micron" | "microns" => (Quantity::Length, 1e-3),
            "s" | "sec" | "seconds" => (Quantity::Time, 1.0),
            "ms" | "msec" => (Quantity::Time, 1e-3),
            "us" | "µs" | "μs" => (Quantity::Time, 1e-6),
            "ns" => (Quantity::Time, 1e-9),
            "rad" | "radians" => (Quantity::Angle, 1.0),
            "deg" | "°" | "degrees" => (Quantity::Angle, std::f64::consts::PI / 180.0),
            "cycles" => (Quantity::Angle, std::f64::consts::TAU),
            _ => return None,
        };
        Some(Self { quantity, size })
    }

    /// By what a number in this unit is multiplied to be one in another; `None` where that measures something
    /// else.
    pub fn factor_to(self, other: Unit) -> Option<f64> {
        (self.quantity == other.quantity).then_some(self.size / other.size)
    }

    pub fn is_time(self) -> bool {
        self.quantity == Quantity::Time
    }

    /// The units that measure the same, for messages.
    pub fn siblings(self) -> &'static str {
        match self.quantity {
            Quantity::Length => "mm, cm, m, um",
            Quantity::Time => "s, ms, us, ns",
            Quantity::Angle => "rad, deg, cycles",
        }
    }
}

/// A column's name and its unit: whatever stands in brackets at its end, or a known unit after the last `_` or
/// blank.
pub(super) fn split_unit(text: &str) -> (&str, Option<&str>) {
    let text = text.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((name, unit)) = text.strip_suffix(close).and_then(|text| text.rsplit_once(open))
            && !name.trim().is_empty()
            && unit.parse::<u32>().is_err()
        {
            return (name.trim_end_matches(['_', ' ']), Some(unit.trim()));
        }
    }
    match text.rsplit_once(['_', ' ']) {
        Some((name, unit)) if !name.is_empty() && Unit::named(&unit.to_lowercase()).is_some() => {
            (name.trim_end_matches(['_', ' ']), Some(unit))
        }
        _ => (text, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_split_from_units() {
        for (text, name, unit) in [
            ("x_mm", "x", Some("mm")),
            ("X [cm]", "X", Some("cm")),
            ("time (ms)", "time", Some("ms")),
            ("x (px)", "x", Some("px")),
            ("lumen_area", "lumen_area", None),
            ("Position X mm", "Position X", Some("mm")),
            ("x[3]", "x[3]", None),
            ("m", "m", None),
            ("[mm]", "[mm]", None),
        ] {
            assert_eq!(split_unit(text), (name, unit), "{text}");
        }
        let metre = Unit::named("m").unwrap();
        assert_eq!(metre.factor_to(Unit::named("mm").unwrap()), Some(1000.0));
        assert_eq!(metre.factor_to(Unit::named("s").unwrap()), None);
    }
}
