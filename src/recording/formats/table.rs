//! Delimited text as spreadsheets and scripts write it.

use crate::{Error, Result};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Rows of numbers separated by tabs, semicolons or commas, with or without a line of column names.
///
/// Lines end in LF or CRLF; a byte order mark is skipped. Where the comma does not separate, it may stand for
/// the decimal point.
pub(crate) struct Table {
    path: PathBuf,
    header: Vec<String>,
    /// The first line, where it holds numbers.
    first: Option<TableRow>,
    records: csv::StringRecordsIntoIter<Cursor<Vec<u8>>>,
    decimal_comma: bool,
}

/// One line of a table.
pub(crate) struct TableRow {
    /// Position of the reader before it; blank lines and half a line end may lie between.
    offset: u64,
    fields: csv::StringRecord,
}

/// A column: its index, and its name in messages.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column<'a> {
    pub index: usize,
    pub name: &'a str,
}

impl Table {
    pub fn open(path: &Path) -> Result<Self> {
        let mut bytes =
            std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        if bytes.starts_with(b"\xef\xbb\xbf") {
            bytes.drain(..3);
        }
        let line = bytes.split(|&b| b == b'\n').find(|l| !l.trim_ascii().is_empty()).unwrap_or_default();
        let delimiter = [b'\t', b';'].into_iter().find(|d| line.contains(d)).unwrap_or(b',');
        let records = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(csv::Trim::All)
            .delimiter(delimiter)
            .from_reader(Cursor::new(bytes))
            .into_records();
        let (path, decimal_comma) = (path.to_owned(), delimiter != b',');
        let mut table = Self { path, header: Vec::new(), first: None, records, decimal_comma };
        table.first = table.next_row()?;
        if let Some(row) = &table.first
            && row.fields.iter().any(|f| !is_missing(f) && table.parse(f).is_none())
        {
            table.header = row.fields.iter().map(str::to_ascii_lowercase).collect();
            table.first = None;
        }
        Ok(table)
    }

    /// Columns of a table that may lack names: found by either of two names each, or else in order from `start`.
    pub fn columns<'a, const N: usize>(
        &self,
        names: [[&'a str; 2]; N],
        start: usize,
    ) -> Result<[Column<'a>; N]> {
        let mut columns = [Column { index: 0, name: "" }; N];
        for (i, (column, [name, other])) in columns.iter_mut().zip(names).enumerate() {
            *column = if self.header.is_empty() {
                Column { index: start + i, name }
            } else {
                match self.optional_column(other)? {
                    Some(column) => column,
                    None => self.column(name)?,
                }
            };
        }
        Ok(columns)
    }

    /// The column of that name.
    pub fn column<'a>(&self, name: &'a str) -> Result<Column<'a>> {
        self.optional_column(name)?.ok_or_else(|| {
            let found = match self.header.len() {
                0 => "no line of column names".into(),
                _ => format!("columns {}", self.header.join(", ")),
            };
            Error::input(&self.path, name, found, format!("a column {name}"))
        })
    }

    /// The columns' names, in lower case; none where the first line holds numbers.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    pub fn optional_column<'a>(&self, name: &'a str) -> Result<Option<Column<'a>>> {
        let mut columns = self.header.iter().enumerate().filter(|(_, n)| n.as_str() == name);
        let column = columns.next().map(|(index, _)| Column { index, name });
        match columns.next() {
            Some(_) => Err(Error::input(&self.path, name, "two columns of that name", "one")),
            None => Ok(column),
        }
    }

    pub fn next_row(&mut self) -> Result<Option<TableRow>> {
        if let Some(row) = self.first.take() {
            return Ok(Some(row));
        }
        match self.records.next().transpose() {
            Ok(record) => Ok(record.map(|fields| {
                let offset = fields.position().map_or(0, csv::Position::byte);
                TableRow { offset, fields }
            })),
            Err(e) => Err(Error::input(&self.path, "text", e, "lines of UTF-8 text")),
        }
    }

    /// The text in a column.
    pub fn text<'a>(&self, row: &'a TableRow, column: Column<'_>) -> Result<&'a str> {
        row.fields.get(column.index).ok_or_else(|| {
            let found = format!("a line of {} fields", row.fields.len());
            self.fault(row, column, found, format!("at least {}", column.index + 1))
        })
    }

    /// The number in a column, never NaN; `None` where the field is empty or a word for a missing value.
    pub fn optional_number(&self, row: &TableRow, column: Column<'_>) -> Result<Option<f64>> {
        let field = self.text(row, column)?;
        match self.parse(field) {
            Some(number) => Ok(Some(number).filter(|number| !number.is_nan())),
            None if is_missing(field) => Ok(None),
            None => Err(self.fault(row, column, format!("{field:?}"), "a number")),
        }
    }

    pub fn number(&self, row: &TableRow, column: Column<'_>) -> Result<f64> {
        self.optional_number(row, column)?.ok_or_else(|| {
            let found = match self.text(row, column) {
                Ok("") | Err(_) => "nothing".into(),
                Ok(word) => format!("{word:?}"),
            };
            self.fault(row, column, found, "a number")
        })
    }

    /// A whole number that is not negative.
    pub fn count(&self, row: &TableRow, column: Column<'_>) -> Result<usize> {
        let number = self.number(row, column)?;
        index(number).ok_or_else(|| self.fault(row, column, number, "a whole number from 0"))
    }

    /// An error that names the line.
    pub fn fault(
        &self,
        row: &TableRow,
        column: Column<'_>,
        found: impl ToString,
        expected: impl ToString,
    ) -> Error {
        let bytes = self.records.reader().get_ref().get_ref();
        let (before, after) = bytes.split_at(bytes.len().min(row.offset as usize));
        let blank = after.iter().take_while(|&&b| b == b'\r' || b == b'\n').count();
        let ends = before.iter().chain(&after[..blank]).filter(|&&b| b == b'\n').count();
        Error::input(&self.path, format!("line {}: {}", ends + 1, column.name), found, expected)
    }

    fn parse(&self, field: &str) -> Option<f64> {
        match field.parse() {
            Ok(number) => Some(number),
            Err(_) if self.decimal_comma && !field.contains('.') => field.replacen(',', ".", 1).parse().ok(),
            Err(_) => None,
        }
    }
}

/// A whole number that is not negative and that a double holds exactly.
pub(super) fn index(number: f64) -> Option<usize> {
    let is_whole = number.fract() == 0.0 && (0.0..9e15).contains(&number);
    is_whole.then_some(number as u64).and_then(|number| usize::try_from(number).ok())
}

/// Whether a field says that there is no value: it is empty or holds the word of a spreadsheet, a statistics package
/// or a C library for that.
pub(super) fn is_missing(field: &str) -> bool {
    const WORDS: [&str; 22] = [
        "",
        "-",
        "--",
        "?",
        ".",
        "nan",
        "na",
        "n/a",
        "n.a.",
        "#n/a",
        "#num!",
        "#value!",
        "#div/0!",
        "null",
        "#null!",
        "none",
        "nil",
        "missing",
        "nan(ind)",
        "nan(snan)",
        "1.#qnan",
        "1.#ind",
    ];
    let word = field.to_ascii_lowercase();
    let unsigned = word.strip_prefix(['-', '+']).filter(|rest| rest.contains("nan") || rest.contains('#'));
    WORDS.contains(&unsigned.unwrap_or(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Table {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Table::open(file.path()).unwrap()
    }

    fn numbers(text: &str) -> Vec<Option<f64>> {
        let mut table = table(text);
        let row = table.next_row().unwrap().unwrap();
        let width = row.fields.len();
        (0..width).map(|index| table.optional_number(&row, Column { index, name: "n" }).unwrap()).collect()
    }

    #[test]
    fn every_separator_and_line_end_reads_the_same() {
        let expected = vec![Some(1.0), Some(-2.5), None, Some(3e-4)];
        for text in [
            "a,b,c,d\n1,-2.5,,3e-4\n",
            "a;b;c;d\r\n1;-2,5;;3e-4\r\n",
            "\u{feff}a\tb\tc\td\r\n1\t-2.5\t\t3e-4",
            "a ; b ; c ; d\n\"1\" ; -2,5 ; ; 0,0003\n",
            "1,-2.5,,3e-4\n",
        ] {
            assert_eq!(numbers(text), expected, "{text:?}");
        }
    }

    #[test]
    fn a_comma_that_separates_is_no_decimal_point() {
        assert_eq!(numbers("1,5\n"), vec![Some(1.0), Some(5.0)]);
    }

    #[test]
    fn messages_count_lines_from_the_files_start() {
        let mut table = table("a,b\r\n1,2\r\n\r\n3,x\r\n");
        let b = table.column("b").unwrap();
        table.next_row().unwrap();
        let row = table.next_row().unwrap().unwrap();
        let message = table.number(&row, b).unwrap_err().to_string();
        assert!(message.ends_with("line 4: b: found \"x\", expected a number"), "{message}");
    }
}
