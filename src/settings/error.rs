//! What is wrong with a file, and where.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use miette::{Diagnostic, LabeledSpan, MietteError, SourceCode, SourceSpan, SpanContents};

/// What is wrong with a recipe or station file, and where.
///
/// Displays the message alone; as a [`miette::Diagnostic`] it also shows file, line, caret and help.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SettingsError {
    pub(super) file: Arc<str>,
    pub(super) text: Arc<str>,
    pub(super) span: Range<usize>,
    pub(super) message: String,
    pub(super) help: Option<String>,
}

impl SettingsError {
    /// The name of the file, as the caller gave it.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The bytes of the text that are to blame; empty at the start of the text when something is missing altogether.
    pub fn span(&self) -> Range<usize> {
        self.span.clone()
    }

    /// What is wrong, one line, with the value and the allowed range where there is one.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// What would be right.
    pub fn help_text(&self) -> Option<&str> {
        self.help.as_deref()
    }

    /// The line of the first byte to blame, from 1.
    pub fn line(&self) -> usize {
        1 + self.text_before().matches('\n').count()
    }

    /// The character of the line at which the caret stands, from 1.
    pub fn column(&self) -> usize {
        let before = self.text_before();
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        1 + before[line_start..].chars().count()
    }

    fn text_before(&self) -> &str {
        &self.text[..self.span.start]
    }
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for SettingsError {}

impl Diagnostic for SettingsError {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.help.as_ref().map(|help| Box::new(help) as _)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(self)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        Some(Box::new(std::iter::once(LabeledSpan::underline(self.span.clone()))))
    }
}

impl SourceCode for SettingsError {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let contents = self.text.read_span(span, lines_before, lines_after)?;
        Ok(Box::new(miette::MietteSpanContents::new_named(
            self.file.to_string(),
            contents.data(),
            *contents.span(),
            contents.line(),
            contents.column(),
            contents.line_count(),
        )))
    }
}
