//! Reader of MAT-files of level 4: matrices of real numbers. Layout: *MAT-File Format*, The MathWorks, chapter
//! 2.

use super::{Array, Budget, ByteOrder, Fields, MAX_BYTES, Stored, Value, numbers, text};
use crate::{Error, Result};
use std::path::Path;

const HEADER_BYTES: usize = 20;
const EXPECTED: &str = "a whole MAT-file of version 4";

/// The header of a matrix.
struct Head {
    stored: Stored,
    /// 0: numbers, 1: text, 2: sparse.
    kind: u32,
    rows: usize,
    columns: usize,
    is_complex: bool,
    name_bytes: usize,
}

/// The byte order of a file of level 4; `None` where it is none.
pub(super) fn byte_order(bytes: &[u8]) -> Option<ByteOrder> {
    [ByteOrder::Little, ByteOrder::Big].into_iter().find(|&order| head(bytes, order).is_some())
}

fn head(bytes: &[u8], order: ByteOrder) -> Option<Head> {
    let words: [[u8; 4]; 5] = bytes.get(..HEADER_BYTES)?.as_chunks().0.try_into().ok()?;
    let [kind, rows, columns, complex, name_bytes] = words.map(|word| order.u32(word));
    // In decimal: byte order, 0, number type, kind.
    let stated = match kind / 1000 {
        0 => ByteOrder::Little,
        1 => ByteOrder::Big,
        _ => return None,
    };
    let stored = match kind / 10 % 100 {
        0 => Stored::F64,
        1 => Stored::F32,
        2 => Stored::I32,
        3 => Stored::I16,
        4 => Stored::U16,
        5 => Stored::U8,
        _ => return None,
    };
    let sound = stated == order && kind % 10 <= 2 && complex <= 1 && (1..=1 << 12).contains(&name_bytes);
    let sizes = [rows, columns].map(|size| (size <= i32::MAX as u32).then_some(size as usize));
    let (&[Some(rows), Some(columns)], true) = (&sizes, sound) else { return None };
    Some(Head {
        stored,
        kind: kind % 10,
        rows,
        columns,
        is_complex: complex == 1,
        name_bytes: name_bytes as usize,
    })
}

/// Reads the variables of a file of level 4.
///
/// # Errors
/// Where the file is damaged or holds too much.
pub(super) fn read(path: &Path, bytes: &[u8], order: ByteOrder, wanted: &[&str]) -> Result<Fields> {
    let mut budget = Budget(MAX_BYTES);
    let mut fields = Fields::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let variable = format!("variable {}", fields.len() + 1);
        let fault = |name: &str, found: String| Error::input(path, name, found, EXPECTED);
        let head =
            head(rest, order).ok_or_else(|| fault(&variable, "something else than a header".into()))?;
        let named = rest.get(HEADER_BYTES..HEADER_BYTES + head.name_bytes);
        let named = named.ok_or_else(|| fault(&variable, "a file that is cut short".into()))?;
        let name = String::from_utf8_lossy(named).trim_end_matches('\0').escape_debug().to_string();
        rest = &rest[HEADER_BYTES + head.name_bytes..];
        let width = match head.stored {
            Stored::F64 => 8,
            Stored::F32 | Stored::I32 => 4,
            Stored::I16 | Stored::U16 => 2,
            _ => 1,
        };
        let parts = if head.is_complex { 2 } else { 1 };
        let count = head.rows.saturating_mul(head.columns);
        let size = count.saturating_mul(width * parts);
        let values = rest
            .get(..size)
            .ok_or_else(|| fault(&name, format!("{} of {size} bytes (the file is cut short)", rest.len())))?;
        rest = &rest[size..];
        let value = match (head.kind, head.is_complex, wanted.contains(&name.as_str())) {
            (_, true, _) => Value::Other("complex numbers"),
            (2, ..) => Value::Other("a sparse array"),
            (.., false) => Value::Other("a full array of real numbers"),
            (kind, ..) => {
                budget.take(count, 8).map_err(|found| fault(&name, found))?;
                let values = numbers(head.stored, order, values).unwrap_or_default();
                match kind {
                    1 => Value::Text(text(&values)),
                    _ => Value::Real(Array { shape: vec![head.rows, head.columns], values }),
                }
            }
        };
        fields.insert(name, value);
    }
    Ok(fields)
}
