//! From TOML text to what was written, checked key by key against the key table.

use std::ops::Range as Span;
use std::sync::Arc;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::SettingsError;
use super::keys::{Key, Kind, Need, Range};

/// The text of one file and the keys it may have.
pub(super) struct Source {
    file: Arc<str>,
    text: Arc<str>,
    keys: &'static [Key],
}

impl Source {
    pub(super) fn new(file: &str, text: &str, keys: &'static [Key]) -> Self {
        Self {
            file: file.into(),
            text: text.into(),
            keys,
        }
    }

    /// What was written, with the defaults filled in. Every value has its type and lies in its range.
    pub(super) fn written<Written: DeserializeOwned>(&self) -> Result<Written, SettingsError> {
        let mut root = DeTable::parse(&self.text).map_err(|error| self.toml_error(&error))?;
        self.check_table(root.get_ref(), "")?;
        self.check_required(root.get_ref())?;
        let defaults_text = self.defaults_text();
        let defaults = DeTable::parse(&defaults_text).expect("the defaults of the key table are TOML");
        fill_in(root.get_mut(), defaults.into_inner());
        Written::deserialize(toml::Deserializer::from(root)).map_err(|error| self.toml_error(&error))
    }

    /// An error at `span`.
    pub(super) fn error(&self, span: Span<usize>, message: String, help: Option<String>) -> SettingsError {
        SettingsError {
            file: self.file.clone(),
            text: self.text.clone(),
            span,
            message,
            help,
        }
    }

    /// An error about the key `path` as a whole, at its name, or at the nearest table above it that was written.
    pub(super) fn error_at_key(&self, path: &str, message: String, help: Option<String>) -> SettingsError {
        let span = match DeTable::parse(&self.text) {
            Ok(root) => span_of_key(root.get_ref(), path),
            Err(_) => 0..0,
        };
        self.error(span, message, help)
    }

    /// An error about the value of `path` at `span`: the message says what it is, the help what is allowed.
    pub(super) fn error_in_value(&self, path: &str, span: Span<usize>, message: String) -> SettingsError {
        let help = self.keys.iter().find(|key| key.path == path).map(Key::allowed_text);
        self.error(span, message, help)
    }

    fn toml_error(&self, error: &toml::de::Error) -> SettingsError {
        let span = error.span().unwrap_or(0..0);
        self.error(span, error.message().trim().replace('\n', ", "), None)
    }

    /// Checks what is there, in the order of the text, so that the first mistake is the one reported.
    fn check_table(&self, table: &DeTable<'_>, table_path: &str) -> Result<(), SettingsError> {
        let mut entries: Vec<_> = table.iter().collect();
        entries.sort_by_key(|(name, _)| name.span().start);
        for (name, value) in entries {
            let path = joined(table_path, name.get_ref());
            if let Some(key) = self.keys.iter().find(|key| key.path == path) {
                self.check_value(key, value)?;
            } else if self.is_table(&path) {
                let DeValue::Table(inner) = value.get_ref() else {
                    let message = format!("`{path}` must be a table, not {}", kind_in_words(value.get_ref()));
                    return Err(self.error(value.span(), message, Some(self.names_in(&path))));
                };
                self.check_table(inner, &path)?;
            } else if self.is_table(&format!("{path}[]")) {
                self.check_tables(&path, value)?;
            } else {
                return Err(self.unknown_key(table_path, name));
            }
        }
        Ok(())
    }

    /// A table that may stand several times.
    fn check_tables(&self, path: &str, value: &Spanned<DeValue<'_>>) -> Result<(), SettingsError> {
        let table_path = format!("{path}[]");
        let elements = match value.get_ref() {
            DeValue::Array(elements) => elements.iter().collect(),
            _ => vec![value],
        };
        for element in elements {
            let DeValue::Table(table) = element.get_ref() else {
                let found = kind_in_words(element.get_ref());
                let message = format!("`{path}` must be tables, each headed [[{path}]], not {found}");
                return Err(self.error(element.span(), message, Some(self.names_in(&table_path))));
            };
            if !value.get_ref().is_array() {
                let message = format!("`{path}` may stand several times: write [[{path}]]");
                return Err(self.error(value.span(), message, None));
            }
            self.check_table(table, &table_path)?;
            for key in self.required_keys() {
                let name = key
                    .path
                    .strip_prefix(&table_path)
                    .and_then(|rest| rest.strip_prefix('.'));
                if name.is_some_and(|name| !has_key(table, name)) {
                    return Err(self.missing_key(key, element.span()));
                }
            }
        }
        Ok(())
    }

    fn check_value(&self, key: &Key, value: &Spanned<DeValue<'_>>) -> Result<(), SettingsError> {
        let wrong_type = || {
            let found = kind_in_words(value.get_ref());
            let message = format!("`{}` must be {}, not {found}", key.path, key.kind_text());
            self.error(value.span(), message, Some(key.allowed_text()))
        };
        match (key.kind, value.get_ref()) {
            (Kind::Text(_), DeValue::String(_)) | (Kind::Toggle, DeValue::Boolean(_)) => Ok(()),
            (Kind::Choice(words), DeValue::String(_)) => self.check_word(key, words, value),
            (Kind::Choices(words), DeValue::Array(elements)) => elements
                .iter()
                .try_for_each(|element| self.check_word(key, words, element)),
            (Kind::Integer(range), DeValue::Integer(_))
            | (Kind::Number(range), DeValue::Integer(_) | DeValue::Float(_)) => {
                self.check_range(key.path, range, value)
            }
            (
                Kind::IntegerList(range) | Kind::Integers(_, range) | Kind::Numbers(_, range),
                DeValue::Array(elements),
            ) => {
                let whole = !matches!(key.kind, Kind::Numbers(..));
                let count = match key.kind {
                    Kind::Integers(count, _) | Kind::Numbers(count, _) => count,
                    _ => elements.len().max(1),
                };
                let fits = |element: &DeValue<'_>| element.is_integer() || (!whole && element.is_float());
                if elements.len() != count {
                    let message = format!("`{}` must be {}, not {}", key.path, key.kind_text(), elements.len());
                    return Err(self.error(value.span(), message, Some(key.allowed_text())));
                }
                for (index, element) in elements.iter().enumerate() {
                    if !fits(element.get_ref()) {
                        let found = kind_in_words(element.get_ref());
                        let message = format!(
                            "`{}` must be {}, not a list with {found} in it",
                            key.path,
                            key.kind_text()
                        );
                        return Err(self.error(element.span(), message, Some(key.allowed_text())));
                    }
                    self.check_range(&format!("{}[{index}]", key.path), range, element)?;
                }
                Ok(())
            }
            _ => Err(wrong_type()),
        }
    }

    /// One of the words, alone or in a list.
    fn check_word(&self, key: &Key, words: &[&'static str], value: &Spanned<DeValue<'_>>) -> Result<(), SettingsError> {
        let DeValue::String(word) = value.get_ref() else {
            let found = kind_in_words(value.get_ref());
            let message = format!(
                "`{}` must be {}, not a list with {found} in it",
                key.path,
                key.kind_text()
            );
            return Err(self.error(value.span(), message, Some(key.allowed_text())));
        };
        if words.contains(&word.as_ref()) {
            return Ok(());
        }
        let message = format!("`{}` cannot be \"{word}\"", key.path);
        let help = suggestion(word, words.iter().copied()) + &key.allowed_text();
        Err(self.error(value.span(), message, Some(help)))
    }

    fn check_range(&self, path: &str, range: Range, value: &Spanned<DeValue<'_>>) -> Result<(), SettingsError> {
        if number_of(value.get_ref()).is_some_and(|number| range.contains(number)) {
            return Ok(());
        }
        let written = &self.text[value.span()];
        let unit = match range.unit {
            "" => String::new(),
            unit => format!(" {unit}"),
        };
        let message = format!("`{path}` is {written}{unit}, allowed is {range}");
        Err(self.error(value.span(), message, None))
    }

    fn check_required(&self, root: &DeTable<'_>) -> Result<(), SettingsError> {
        for key in self.required_keys().filter(|key| !key.path.contains("[]")) {
            if !has_key(root, key.path) {
                return Err(self.missing_key(key, span_of_key(root, key.path)));
            }
        }
        Ok(())
    }

    fn required_keys(&self) -> impl Iterator<Item = &'static Key> {
        self.keys.iter().filter(|key| key.need == Need::Required)
    }

    fn missing_key(&self, key: &Key, span: Span<usize>) -> SettingsError {
        let message = format!("`{}` is missing: it must be {}", key.path, key.kind_text());
        self.error(span, message, Some(key.allowed_text()))
    }

    fn unknown_key(&self, table_path: &str, name: &Spanned<std::borrow::Cow<'_, str>>) -> SettingsError {
        let path = joined(table_path, name.get_ref());
        let elsewhere = self
            .keys
            .iter()
            .filter_map(|key| key.path.rsplit_once('.'))
            .find(|(_, last)| last == name.get_ref());
        let near = suggestion(name.get_ref(), self.child_names(table_path).into_iter());
        let hint = match elsewhere {
            Some((table, _)) if near.is_empty() => format!("`{}` belongs in [{table}]; ", name.get_ref()),
            _ => near,
        };
        let message = format!("unknown key `{path}`");
        self.error(name.span(), message, Some(hint + &self.names_in(table_path)))
    }

    fn names_in(&self, table_path: &str) -> String {
        let names = self.child_names(table_path).join(", ");
        match table_path {
            "" => format!("keys of the file: {names}"),
            path => match path.strip_suffix("[]") {
                Some(path) => format!("keys of [[{path}]]: {names}"),
                None => format!("keys of [{path}]: {names}"),
            },
        }
    }

    /// The names directly under a table, in the order of the key table, each once.
    fn child_names(&self, table_path: &str) -> Vec<&'static str> {
        let mut names = Vec::new();
        for key in self.keys {
            let below = match table_path {
                "" => Some(key.path),
                path => key.path.strip_prefix(path).and_then(|rest| rest.strip_prefix('.')),
            };
            let name = below.map(|below| below.split('.').next().unwrap_or(below).trim_end_matches("[]"));
            names.extend(name.filter(|name| !names.contains(name)));
        }
        names
    }

    fn is_table(&self, path: &str) -> bool {
        !self.child_names(path).is_empty()
    }

    fn defaults_text(&self) -> String {
        self.keys
            .iter()
            .filter_map(|key| match key.need {
                Need::Default(toml) => Some(format!("{} = {toml}\n", key.path)),
                Need::Required | Need::Optional(_) => None,
            })
            .collect()
    }
}

fn joined(table_path: &str, name: &str) -> String {
    match table_path {
        "" => name.to_owned(),
        path => format!("{path}.{name}"),
    }
}

/// Adds to `table` what only `defaults` has.
fn fill_in<'text>(table: &mut DeTable<'text>, defaults: DeTable<'text>) {
    for (name, default) in defaults {
        match (table.get_mut(&name).map(Spanned::get_mut), default.get_ref()) {
            (Some(DeValue::Table(inner)), DeValue::Table(_)) => {
                if let DeValue::Table(inner_defaults) = default.into_inner() {
                    fill_in(inner, inner_defaults);
                }
            }
            (Some(_), _) => {}
            (None, _) => {
                table.insert(name, default);
            }
        }
    }
}

fn has_key(table: &DeTable<'_>, path: &str) -> bool {
    match path.split_once('.') {
        None => table.get(path).is_some(),
        Some((name, rest)) => table
            .get(name)
            .and_then(|value| value.get_ref().as_table())
            .is_some_and(|inner| has_key(inner, rest)),
    }
}

/// Where the name of the key stands, or of the nearest table above it, or the start of the text.
fn span_of_key(root: &DeTable<'_>, path: &str) -> Span<usize> {
    let mut span = 0..0;
    let mut table = Some(root);
    for name in path.split('.') {
        let Some((key, value)) = table.and_then(|table| table.get_key_value(name)) else {
            break;
        };
        span = key.span();
        table = value.get_ref().as_table();
    }
    span
}

fn number_of(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix())
            .ok()
            .map(|integer| integer as f64),
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

fn kind_in_words(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "text",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number with a fraction",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date or time",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}

/// "did you mean `x`? " when one of `names` is close to `written`, else nothing.
fn suggestion<'name>(written: &str, names: impl Iterator<Item = &'name str>) -> String {
    let edits_max = (written.chars().count() / 3).max(1);
    names
        .map(|name| (edit_count(written, name), name))
        .min_by_key(|(edits, _)| *edits)
        .filter(|(edits, _)| *edits <= edits_max)
        .map_or(String::new(), |(_, name)| format!("did you mean `{name}`? "))
}

/// How many letters must be added, dropped or replaced to make `b` of `a`.
fn edit_count(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, letter) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, other) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(letter != *other);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}
