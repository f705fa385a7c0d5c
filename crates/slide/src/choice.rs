//! Files of several images: which is looked at, and what there was to choose from.

/// Which image of a file is looked at. Without a wish: the finest one, or the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// A page, counted from 0.
    pub page: Option<usize>,
    /// A channel, counted from 0.
    pub channel: Option<usize>,
}

/// What there was to choose from, and what is looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choices {
    /// How many images there are as pages, reduced ones not counted.
    pub pages: usize,
    /// The page that is looked at.
    pub page: usize,
    /// The names of the channels, empty where there is none; no channel: there is nothing to choose.
    pub channels: Vec<String>,
    /// The channel that is looked at.
    pub channel: usize,
}

impl Default for Choices {
    fn default() -> Self {
        Self {
            pages: 1,
            page: 0,
            channels: Vec::new(),
            channel: 0,
        }
    }
}

impl Choices {
    /// In words, where there is a choice: what there is, and what is looked at.
    #[must_use]
    pub fn told(&self) -> Option<String> {
        let n = self.channels.len();
        if n > 1 {
            let named = |(k, name): (usize, &String)| match name.as_str() {
                "" => format!("{k}"),
                name => format!("{k} {name}"),
            };
            let names: Vec<String> = self
                .channels
                .iter()
                .enumerate()
                .take(16)
                .map(named)
                .collect();
            let pages = match self.pages > n {
                true => format!(" on {} pages", self.pages),
                false => String::new(),
            };
            return Some(format!(
                "{n} channels ({}){pages}; looking at channel {}, page {}",
                names.join(", "),
                self.channel,
                self.page
            ));
        }
        let told = || format!("{} pages; looking at page {}", self.pages, self.page);
        (self.pages > 1).then(told)
    }
}
