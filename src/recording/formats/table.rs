//! Delimited text as spreadsheets and scripts write it.

use super::units::{Unit, split_unit};
use crate::text::{self, shown};
use crate::{Error, Result};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Rows of fields, with or without a line of column names.
///
/// - Fields are separated by tabs, semicolons, commas or runs of blanks: by what makes most fields of the first
///   lines numbers. A first line `sep=;` says it.
/// - A field is quoted where it begins with a quote and a quote ends it in the same line; any other quote is
///   text. So no field spans lines.
/// - Every line has as many fields as the first one; empty ones may follow.
/// - Blank lines and lines that begin with `#`, `%` or `//` are skipped, but for column names in such a line
///   directly above the first numbers.
/// - Where the comma does not separate, and in quotes, it may stand for the decimal point.
/// - Column names may give a unit: `x_mm`, `x [mm]`, `x (mm)`, or a line of units below them. Numbers in
///   another unit than the one that is asked for are converted.
/// - Text is UTF-8, UTF-16 with a byte order mark, or else Windows-1252. Lines end in LF, CRLF or CR.
pub(crate) struct Table {
    path: PathBuf,
    text: String,
    /// Where the next line begins, and its number from 1.
    next: (usize, usize),
    delimiter: char,
    /// The columns' names, and their units where they are given; none where the first line holds numbers.
    header: Vec<Header>,
    /// Fields that every line has.
    width: usize,
}

/// The name of a column.
struct Header {
    /// As the file has it.
    text: String,
    /// In lower case, words joined by `_`, without the unit.
    name: String,
    /// In lower case; it may be none that we know.
    unit: Option<String>,
}

/// One line of a table.
pub(crate) struct TableRow {
    /// Its number in the file, from 1.
    line: usize,
    /// Where its fields are in the text.
    fields: Vec<Range<usize>>,
}

/// A column: its index, its name in messages where the table has none, and by what its numbers are multiplied.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column {
    index: usize,
    name: &'static str,
    factor: f64,
}

/// Lines that tell what separates fields.
const SAMPLE_LINES: usize = 32;
/// Characters of a field that a message shows.
const SHOWN: usize = 40;

impl Table {
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_named(path, None)
    }

    /// As [`open`](Self::open); with names, the file has no line of column names, and these stand for it.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_named(path: &Path, names: Option<&[String]>) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        let text = text::decoded(&bytes).into_owned();
        if text.contains('\0') {
            return Err(Error::input(path, "text", "bytes of zero", "lines of text"));
        }
        let (path, header) = (path.to_owned(), Vec::new());
        let mut table = Self { path, text, next: (0, 1), delimiter: ',', header, width: 0 };
        let start = table.next;
        let stated = table.next_line().and_then(|(line, _)| separator_line(&table.text[line]));
        if stated.is_none() {
            table.next = start;
        }
        table.delimiter = stated.unwrap_or_else(|| table.likeliest_delimiter());
        match names {
            None => table.read_header()?,
            Some(names) => {
                table.header = names.iter().map(|name| Header::new(name)).collect();
                table.width = names.len();
            }
        }
        Ok(table)
    }

    /// The separator that makes the largest share of fields numbers; of equal ones the first.
    fn likeliest_delimiter(&mut self) -> char {
        let start = self.next;
        let sample: Vec<Range<usize>> =
            std::iter::from_fn(|| self.next_content()).take(SAMPLE_LINES).map(|(line, _)| line).collect();
        self.next = start;
        let share = |delimiter: char| {
            let (mut fields, mut numbers) = (0, 0);
            for line in &sample {
                for field in split(&self.text, line.clone(), delimiter) {
                    fields += 1;
                    numbers += usize::from(is_number(&self.text[field]));
                }
            }
            (fields > sample.len()).then_some(numbers as f64 / f64::from(fields.max(1) as u32))
        };
        let shares = ['\t', ';', ',', ' '].map(|delimiter| (delimiter, share(delimiter)));
        let best = shares
            .into_iter()
            .rev()
            .max_by(|a, b| a.1.partial_cmp(&b.1).unwrap_or(std::cmp::Ordering::Equal));
        best.filter(|(_, share)| share.is_some()).map_or(',', |(delimiter, _)| delimiter)
    }

    /// Reads the column names, if there are any, and the line of units below them.
    fn read_header(&mut self) -> Result<()> {
        let start = self.next;
        let mut comment = None;
        let mut first = None;
        while let Some((line, number)) = self.next_line() {
            if self.text[line.clone()].trim().is_empty() {
                continue;
            }
            match self.uncommented(&line) {
                Some(names) => comment = Some(names),
                None => {
                    first = Some((line, number));
                    break;
                }
            }
        }
        let Some((line, _)) = first else { return Ok(()) };
        let fields = self.split(line.clone());
        let is_name = |field: &Range<usize>| !is_number(&self.text[field.clone()]);
        if fields.iter().any(is_name) {
            self.header = fields.iter().map(|field| Header::new(&self.text[field.clone()])).collect();
            while self.header.last().is_some_and(|last| last.text.is_empty()) {
                self.header.pop();
            }
            self.width = self.header.len();
            self.read_units();
            return Ok(());
        }
        self.width = fields.len();
        if let Some(names) = comment {
            let names = self.split(names);
            let one_word = |field: &Range<usize>| {
                is_name(field)
                    && !split_unit(&self.text[field.clone()]).0.trim().contains(char::is_whitespace)
            };
            if names.len() == fields.len() && names.iter().all(one_word) {
                self.header = names.into_iter().map(|field| Header::new(&self.text[field])).collect();
            }
        }
        // The first line is read again, as a row.
        self.next = start;
        Ok(())
    }

    /// Takes the units in the next line, if it has nothing but units.
    fn read_units(&mut self) {
        let before = self.next;
        let Some((line, _)) = self.next_content() else { return };
        let units: Vec<String> = self
            .split(line)
            .into_iter()
            .map(|field| self.text[field].trim_matches(['[', ']', '(', ')']).trim().to_lowercase())
            .collect();
        let is_unit = |unit: &String| unit.is_empty() || unit == "-" || Unit::named(unit).is_some();
        if units.len() == self.width
            && units.iter().all(is_unit)
            && units.iter().any(|u| Unit::named(u).is_some())
        {
            for (header, unit) in self.header.iter_mut().zip(units) {
                if Unit::named(&unit).is_some() {
                    header.unit = Some(unit);
                }
            }
        } else {
            self.next = before;
        }
    }

    /// Columns of a table that may lack names: then in order from `start`.
    ///
    /// # Errors
    /// Where a name is not there; and where a table without names has more columns, and no number a decimal
    /// point, because it seems to have decimal commas.
    pub fn columns<const N: usize>(&self, names: [&'static str; N], start: usize) -> Result<[Column; N]> {
        if self.header.is_empty() && self.delimiter == ',' && self.width > start + N && self.lacks_points() {
            let found = format!("{} fields without a decimal point in any", self.width);
            let expected =
                format!("{}: numbers with decimal commas in quotes, or separated by semicolons", start + N);
            return Err(Error::input(&self.path, "lines", found, expected));
        }
        let mut columns = [Column { index: 0, name: "", factor: 1.0 }; N];
        for (i, (column, name)) in columns.iter_mut().zip(names).enumerate() {
            *column = match self.header.is_empty() {
                true => Column { index: start + i, name, factor: 1.0 },
                false => self.column(name)?,
            };
        }
        Ok(columns)
    }

    /// Whether no number in the first lines has a decimal point.
    fn lacks_points(&self) -> bool {
        !self.text.lines().take(SAMPLE_LINES).any(|line| line.contains('.'))
    }

    /// The column of that name.
    pub fn column(&self, name: &'static str) -> Result<Column> {
        self.optional_column(name)?.ok_or_else(|| self.no_column(name))
    }

    /// What is there instead of a column.
    fn no_column(&self, name: &str) -> Error {
        let found = match self.header.len() {
            0 => "no line of column names".into(),
            _ => {
                let names: Vec<&str> = self.header.iter().map(|h| h.text.as_str()).collect();
                format!("columns {}", shown(&names.join(", "), 4 * SHOWN))
            }
        };
        Error::input(&self.path, name, found, format!("a column {name}"))
    }

    /// The column of that name, in whatever unit and by whatever [other name](other_names) the table has it.
    pub fn optional_column(&self, name: &'static str) -> Result<Option<Column>> {
        let (plain, unit) = split_unit(name);
        let unit = unit.and_then(Unit::named);
        for name_there in other_names(plain).iter().copied().chain([plain]).rev() {
            let there = || self.header.iter().enumerate().filter(|(_, h)| h.name == name_there);
            let with_unit: Vec<_> = there().filter(|(_, h)| h.unit.is_some()).collect();
            let there = if with_unit.is_empty() { there().collect() } else { with_unit };
            match there[..] {
                [] => {}
                [(index, header)] => return self.in_unit(Column { index, name, factor: 1.0 }, header, unit),
                _ => return Err(Error::input(&self.path, name, "two columns of that name", "one")),
            }
        }
        Ok(None)
    }

    /// The column with the factor from its unit to the one that is asked for.
    fn in_unit(&self, column: Column, header: &Header, asked: Option<Unit>) -> Result<Option<Column>> {
        let (Some(asked), name) = (asked, column.name) else { return Ok(Some(column)) };
        let Some(unit) = &header.unit else {
            // Times without a unit are not used: they may be seconds, milliseconds, or counts of a clock.
            return Ok(Some(column).filter(|_| !asked.is_time()));
        };
        match Unit::named(unit).and_then(|unit| unit.factor_to(asked)) {
            Some(factor) => Ok(Some(Column { factor, ..column })),
            None => {
                let found = format!("the unit {:?} in {:?}", shown(unit, SHOWN), shown(&header.text, SHOWN));
                Err(Error::input(&self.path, name, found, format!("one of {}", asked.siblings())))
            }
        }
    }

    /// The column that is headed exactly so, but for case, its numbers as they are.
    pub fn column_headed(&self, text: &str) -> Result<Column> {
        let index = self.header.iter().position(|h| h.text.eq_ignore_ascii_case(text));
        let column = |index| Column { index, name: "", factor: 1.0 };
        index.map(column).ok_or_else(|| self.no_column(text))
    }

    /// The columns of that name with a number after it, by these numbers: `x0`, `x1`, …
    pub fn numbered_columns(&self, name: &'static str) -> Result<Vec<Column>> {
        let (plain, unit) = split_unit(name);
        let mut columns = Vec::new();
        for (index, header) in self.header.iter().enumerate() {
            let digits =
                header.name.strip_prefix(plain).map(|rest| rest.trim_matches(['_', '[', ']', '(', ')']));
            let Some(number) = digits.and_then(|digits| digits.parse::<u32>().ok()) else { continue };
            let column = Column { index, name, factor: 1.0 };
            columns.extend(
                self.in_unit(column, header, unit.and_then(Unit::named))?.map(|column| (number, column)),
            );
        }
        columns.sort_by_key(|(number, _)| *number);
        match columns.windows(2).any(|pair| pair[0].0 == pair[1].0) {
            true => Err(Error::input(&self.path, name, "two columns of one number", "one of each")),
            false => Ok(columns.into_iter().map(|(_, column)| column).collect()),
        }
    }

    /// The columns whose names, as the file has them, pass a test.
    pub fn columns_where<'a, T: 'a>(
        &'a self,
        test: impl Fn(&str) -> Option<T> + 'a,
    ) -> impl Iterator<Item = (Column, T)> + 'a {
        let column = move |(index, header): (usize, &Header)| {
            Some((Column { index, name: "", factor: 1.0 }, test(&header.text)?))
        };
        self.header.iter().enumerate().filter_map(column)
    }

    pub fn next_row(&mut self) -> Result<Option<TableRow>> {
        let Some((range, line)) = self.next_content() else { return Ok(None) };
        let mut fields = self.split(range);
        while fields.len() > self.width
            && fields.last().is_some_and(|last| self.text[last.clone()].is_empty())
        {
            fields.pop();
        }
        if fields.len() != self.width {
            let expected = match self.header.is_empty() {
                true => "as in the first line",
                false => "one for each column name",
            };
            let (found, expected) =
                (format!("{} fields", fields.len()), format!("{}, {expected}", self.width));
            return Err(Error::input(&self.path, format!("line {line}"), found, expected));
        }
        Ok(Some(TableRow { line, fields }))
    }

    /// The next line, without its end, and its number; none at the end of the text.
    fn next_line(&mut self) -> Option<(Range<usize>, usize)> {
        let (start, number) = self.next;
        let rest = self.text.get(start..).filter(|rest| !rest.is_empty())?;
        let length = rest.find(['\r', '\n']).unwrap_or(rest.len());
        let end = if rest[length..].starts_with("\r\n") { 2 } else { 1 };
        self.next = (start + length + end, number + 1);
        Some((start..start + length, number))
    }

    /// The next line that is neither blank nor a comment.
    fn next_content(&mut self) -> Option<(Range<usize>, usize)> {
        loop {
            let (line, number) = self.next_line()?;
            if !self.text[line.clone()].trim().is_empty() && self.uncommented(&line).is_none() {
                return Some((line, number));
            }
        }
    }

    /// What a comment says; `None` where the line is none.
    fn uncommented(&self, line: &Range<usize>) -> Option<Range<usize>> {
        let text = &self.text[line.clone()];
        let said = ["#", "%", "//"].into_iter().find_map(|mark| text.trim_start().strip_prefix(mark))?;
        let first = text.split([self.delimiter, ',', ';', '\t']).next().unwrap_or_default();
        (!is_missing(first.trim())).then(|| line.end - said.len()..line.end)
    }

    fn split(&self, line: Range<usize>) -> Vec<Range<usize>> {
        split(&self.text, line, self.delimiter)
    }

    /// The text in a column.
    pub fn text<'a>(&'a self, row: &TableRow, column: Column) -> Result<&'a str> {
        let field = row.fields.get(column.index).ok_or_else(|| {
            let found = format!("a line of {} fields", row.fields.len());
            self.fault(row, column, found, format!("at least {}", column.index + 1))
        })?;
        Ok(&self.text[field.clone()])
    }

    /// The number in a column, never NaN; `None` where the field is empty or a word for a missing value.
    pub fn optional_number(&self, row: &TableRow, column: Column) -> Result<Option<f64>> {
        let field = self.text(row, column)?;
        match parse(field) {
            Some(number) => Ok(Some(number * column.factor).filter(|number| !number.is_nan())),
            None if is_missing(field) => Ok(None),
            None => Err(self.fault(row, column, quoted(field), "a number")),
        }
    }

    pub fn number(&self, row: &TableRow, column: Column) -> Result<f64> {
        self.optional_number(row, column)?.ok_or_else(|| {
            let found = match self.text(row, column) {
                Ok("") | Err(_) => "nothing".into(),
                Ok(word) => quoted(word),
            };
            self.fault(row, column, found, "a number")
        })
    }

    /// A whole number that is not negative.
    pub fn count(&self, row: &TableRow, column: Column) -> Result<usize> {
        let number = self.number(row, column)?;
        index(number).ok_or_else(|| self.fault(row, column, number, "a whole number from 0"))
    }

    /// An error that names the line.
    pub fn fault(
        &self,
        row: &TableRow,
        column: Column,
        found: impl ToString,
        expected: impl ToString,
    ) -> Error {
        let name = self.header.get(column.index).map_or(column.name, |header| &header.text);
        let field = format!("line {}: {}", row.line, shown(name, SHOWN));
        Error::input(&self.path, field, found, expected)
    }
}

impl Header {
    fn new(text: &str) -> Self {
        let (name, unit) = split_unit(text);
        let words: Vec<String> =
            name.split([' ', '-', '.', '_']).filter(|w| !w.is_empty()).map(str::to_lowercase).collect();
        Self { text: text.to_owned(), name: words.join("_"), unit: unit.map(str::to_lowercase) }
    }
}

/// Names under which programs write what we call by another name, the likeliest last.
fn other_names(name: &str) -> &'static [&'static str] {
    match name {
        "frame" => &["frame_index", "frame_id", "frame_no", "frame_nr", "frame_number"],
        "time" => &["t", "timestamp"],
        "x" => &["position_x", "pos_x", "ep_x"],
        "y" => &["position_y", "pos_y", "ep_y"],
        "z" => &["position_z", "pos_z", "ep_z"],
        "qx" => &["quaternion_x", "quat_x", "q_x"],
        "qy" => &["quaternion_y", "quat_y", "q_y"],
        "qz" => &["quaternion_z", "quat_z", "q_z"],
        "qw" => &["quaternion_w", "quat_w", "q_w"],
        _ => &[],
    }
}

/// What a line `sep=;` says.
fn separator_line(line: &str) -> Option<char> {
    let said =
        line.trim_start().trim_matches('"').strip_prefix("sep=").or_else(|| line.strip_prefix("SEP="))?;
    match said.trim_end_matches('"') {
        "\\t" => Some('\t'),
        said => said.chars().next().filter(|c| c.len_utf8() == said.trim_end().len().max(1)),
    }
}

/// The fields of a line, without quotes and blanks about them.
fn split(text: &str, line: Range<usize>, delimiter: char) -> Vec<Range<usize>> {
    let mut fields = Vec::new();
    let mut start = line.start;
    let trimmed = |range: Range<usize>| {
        let field = &text[range.clone()];
        let start = range.start + (field.len() - field.trim_start().len());
        start..start + field.trim().len()
    };
    loop {
        if delimiter == ' ' {
            start = line.end - text[start..line.end].trim_start().len();
            if start == line.end {
                return fields;
            }
        }
        let rest = &text[start..line.end];
        let end = match closing_quote(rest, delimiter) {
            Some((inside, end)) => {
                fields.push(trimmed(start + inside.start..start + inside.end));
                start + end
            }
            None => {
                let at = |c: char| if delimiter == ' ' { c.is_whitespace() } else { c == delimiter };
                let end = start + rest.find(at).unwrap_or(rest.len());
                fields.push(trimmed(start..end));
                end
            }
        };
        match text[end..line.end].chars().next() {
            Some(separator) => start = end + separator.len_utf8(),
            None => return fields,
        }
    }
}

/// What a quoted field at the start of a text holds, and where the field ends; `None` where there is no such
/// field.
fn closing_quote(text: &str, delimiter: char) -> Option<(Range<usize>, usize)> {
    let open = text.len() - text.trim_start_matches([' ', '\u{a0}']).len();
    let inside = text[open..].strip_prefix('"')?;
    let mut at = 0;
    loop {
        at += inside[at..].find('"')?;
        if inside[at + 1..].starts_with('"') {
            at += 2;
            continue;
        }
        let after = &inside[at + 1..];
        let blanks = if delimiter == ' ' { 0 } else { after.len() - after.trim_start_matches(' ').len() };
        let ends = match after[blanks..].chars().next() {
            None => true,
            Some(c) => c == delimiter || (delimiter == ' ' && c.is_whitespace()),
        };
        return ends.then(|| (open + 1..open + 1 + at, open + 1 + at + 1 + blanks));
    }
}

/// Whether a field is a number or stands for a missing one.
fn is_number(field: &str) -> bool {
    parse(field).is_some() || is_missing(field)
}

fn parse(field: &str) -> Option<f64> {
    match field.parse() {
        Ok(number) => Some(number),
        Err(_) if field.contains(',') && !field.contains('.') => field.replacen(',', ".", 1).parse().ok(),
        Err(_) => None,
    }
}

/// A field for a message: in quotes, control characters escaped, not too long.
pub(super) fn quoted(field: &str) -> String {
    format!("{:?}", shown(field, SHOWN))
}

/// A whole number that is not negative and that a double holds exactly.
pub(super) fn index(number: f64) -> Option<usize> {
    let is_whole = number.fract() == 0.0 && (0.0..9e15).contains(&number);
    is_whole.then_some(number as u64).and_then(|number| usize::try_from(number).ok())
}

/// Whether a field says that there is no value: it is empty or holds the word of a spreadsheet, a statistics
/// package or a C library for that.
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
    if field.len() > 10 {
        return false;
    }
    let word = field.to_ascii_lowercase();
    let unsigned = word.strip_prefix(['-', '+']).filter(|rest| rest.contains("nan") || rest.contains('#'));
    WORDS.contains(&unsigned.unwrap_or(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(bytes: &[u8]) -> Result<Table> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        Table::open(file.path())
    }

    fn table(text: &str) -> Table {
        opened(text.as_bytes()).unwrap()
    }

    /// All numbers of a table.
    fn rows(table: &mut Table) -> Vec<Vec<Option<f64>>> {
        let mut rows = Vec::new();
        while let Some(row) = table.next_row().unwrap() {
            let column = |index| Column { index, name: "n", factor: 1.0 };
            rows.push((0..table.width).map(|i| table.optional_number(&row, column(i)).unwrap()).collect());
        }
        rows
    }

    #[test]
    fn every_dialect_reads_the_same() {
        let expected =
            [vec![Some(1.0), Some(-2.5), None, Some(3e-4)], vec![Some(2.0), Some(0.5), Some(1.0), None]];
        for text in [
            "a,b,c,d\n1,-2.5,,3e-4\n2,0.5,1,\n",
            "a;b;c;d\r\n1;-2,5;;3e-4\r\n2;0,5;1;NaN",
            "a\tb\tc\td\r1\t-2.5\t\t3e-4\r2\t0.5\t1\t\r",
            "\u{feff}a\tb\tc\td\r\n1\t-2.5\t\t3e-4\n2\t0.5\t1\t#N/A",
            "a ; b ; c ; d\n\"1\" ; -2,5 ; ; 0,0003\n 2;,5;1;null\n",
            "a,b,c,d\n1,\"-2,5\",-,\"0,0003\"\n2,\"0,5\",1,N/A\n",
            "a b c d\n  1 -2.5  NA 3e-4\n2   0.5 1 none  \n",
            "sep=;\na;b;c;d\n1;-2,5;;3e-4\n2;0,5;1;\n",
            "\"sep=,\"\na,b,c,d\n1,-2.5,,3e-4\n2,0.5,1,\n",
            "1,-2.5,,3e-4\n2,0.5,1,nan\n",
            "# made by hand, twice\na,b,c,d\n% before\n\n1,-2.5,,3e-4\n// between\n2,0.5,1,\n# after",
            "a,b,c,d,,\n1,-2.5,,3e-4,,\n2,0.5,1,,,\n",
            "# a b c d\n1 -2.5 nan 3e-4\n2 0.5 1 -nan(ind)\n",
            "a [mm],b,c (s),d\nmm,,s,-\n1,-2.5,,3e-4\n2,0.5,1,\n",
        ] {
            assert_eq!(rows(&mut table(text)), expected, "{text:?}");
        }
    }

    #[test]
    fn every_encoding_reads_the_same() {
        let text = "frame,x_mm,remark\n1,2.5,Größe °\n";
        let utf16 = |order: fn(u16) -> [u8; 2]| -> Vec<u8> {
            ['\u{feff}'].into_iter().chain(text.chars()).flat_map(|c| order(c as u16)).collect()
        };
        let latin_1: Vec<u8> = text.chars().map(|c| c as u8).collect();
        for bytes in [text.into(), utf16(u16::to_le_bytes), utf16(u16::to_be_bytes), latin_1] {
            let mut table = opened(&bytes).unwrap();
            let [frame, x] = table.columns(["frame", "x_mm"], 0).unwrap();
            let row = table.next_row().unwrap().unwrap();
            assert_eq!((table.count(&row, frame).unwrap(), table.number(&row, x).unwrap()), (1, 2.5));
            assert_eq!(table.text(&row, Column { index: 2, ..x }).unwrap(), "Größe °");
        }
        let said = opened(b"frame,x\n1,\0\n").err().unwrap().to_string();
        assert!(said.ends_with("text: found bytes of zero, expected lines of text"), "{said}");
    }

    #[test]
    fn a_comma_that_separates_is_no_decimal_point() {
        assert_eq!(rows(&mut table("1,5\n")), [[Some(1.0), Some(5.0)]]);
    }

    #[test]
    fn a_lone_quote_is_text() {
        for field in ["\"calcium", "calc\"ium", "5\"", "\"a\" b", "\"\"\"", "\""] {
            let mut table = table(&format!("x,note\n1,{field}\n2,\"a, \"\"b\"\"\"\n3,\n"));
            let [x, note] = table.columns(["x", "note"], 0).unwrap();
            let row = table.next_row().unwrap().unwrap();
            assert_eq!((table.number(&row, x).unwrap(), table.text(&row, note).unwrap()), (1.0, field));
            let row = table.next_row().unwrap().unwrap();
            assert_eq!(
                (table.number(&row, x).unwrap(), table.text(&row, note).unwrap()),
                (2.0, "a, \"\"b\"\"")
            );
            let row = table.next_row().unwrap().unwrap();
            assert_eq!(table.number(&row, x).unwrap(), 3.0, "{field}");
        }
    }

    #[test]
    fn a_line_with_another_number_of_fields_is_refused() {
        for (text, expected) in [
            ("x,y,z\n1,2,3\n1,5,2,5,3,5\n", "line 3: found 6 fields, expected 3, one for each column name"),
            ("1,2,3\n\n1,2\n", "line 3: found 2 fields, expected 3, as in the first line"),
            ("x y z\n1 2 3\n1 2 3 4\n", "line 3: found 4 fields, expected 3, one for each column name"),
            ("x,y,note\n1,2,3\n1,2,\"two\nlines\"\n", "line 4: found 1 fields, expected 3"),
        ] {
            let mut table = table(text);
            let error = std::iter::from_fn(|| table.next_row().transpose()).find_map(Result::err).unwrap();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn units_are_those_of_the_header() {
        for (header, expected) in [
            ("frame,x_mm,time_s,theta_rad", [2.5, 4.0, 90.0]),
            ("Frame,X [mm],Time (s),Theta", [2.5, 4.0, 90.0]),
            ("frame number,Ep_x,t [ms],theta (deg)", [2.5, 0.004, std::f64::consts::FRAC_PI_2]),
            ("frame_id,pos x [cm],timestamp_us,theta_deg", [25.0, 4e-6, std::f64::consts::FRAC_PI_2]),
            ("frame,x_m,time_ns,theta [°]\n", [2500.0, 4e-9, std::f64::consts::FRAC_PI_2]),
            ("frame,x,time,theta\n-,µm,ms,rad", [0.0025, 0.004, 90.0]),
            ("frame,x,x_mm,time_s,theta", [2.5, 4.0, 90.0]),
        ] {
            let values = if header.contains("x,x_mm") { "1,77,2.5,4,90" } else { "1,2.5,4,90" };
            let mut table = table(&format!("{header}\n{values}\n"));
            let columns = table.columns(["x_mm", "time_s", "theta_rad"], 0).unwrap();
            let frame = table.column("frame").unwrap();
            let row = table.next_row().unwrap().unwrap();
            assert_eq!(table.count(&row, frame).unwrap(), 1, "{header}");
            for (column, expected) in columns.into_iter().zip(expected) {
                let number = table.number(&row, column).unwrap();
                assert!((number - expected).abs() <= 1e-15 * expected, "{header}: {number} for {expected}");
            }
        }
        assert!(table("frame,time\n1,2\n").optional_column("time_s").unwrap().is_none());
        for (header, expected) in [
            ("x [px],y", "x_mm: found the unit \"px\" in \"x [px]\", expected one of mm, cm, m, um"),
            ("x_s,y", "x_mm: found the unit \"s\" in \"x_s\", expected one of mm"),
            ("x_mm,X [mm]", "x_mm: found two columns of that name, expected one"),
            ("y,a\u{7}b", "x_mm: found columns y, a\u{fffd}b, expected a column x_mm"),
        ] {
            let said = table(&format!("{header}\n1,2\n")).column("x_mm").unwrap_err().to_string();
            assert!(said.contains(expected), "{said}");
        }
    }

    #[test]
    fn messages_count_lines_from_the_files_start() {
        let mut table = table("# c\ra,b\r\n1,2\r\n\n3,x\u{1b}[31m\r\n");
        let b = table.column("b").unwrap();
        table.next_row().unwrap();
        let row = table.next_row().unwrap().unwrap();
        let message = table.number(&row, b).unwrap_err().to_string();
        assert!(message.ends_with("line 5: b: found \"x\u{fffd}[31m\", expected a number"), "{message}");
    }
}
