//! Who may do what: users with passwords, programs with tokens, browsers with sessions.

mod guesses;
mod role;
mod sessions;
mod store;

use crate::error::ApiError;
use crate::lock;
use crate::random::{checksum, secret};
use argon2::Argon2;
use argon2::password_hash::phc::PasswordHash;
use argon2::password_hash::{PasswordHasher as _, PasswordVerifier as _};
use axum::http::StatusCode;
use guesses::Guesses;
pub(crate) use role::Role;
use sessions::Sessions;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use store::{Account, Accounts, Token};

/// Who asks.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Caller {
    pub(crate) user: String,
    pub(crate) role: Role,
    /// The browser's session, or the program's token: what a seat is held by.
    pub(crate) key: String,
    /// On the computer at the microscope.
    pub(crate) here: bool,
    /// Whether what moves may be asked from there: here, or where somebody here allowed it.
    pub(crate) near: bool,
}

/// The user of a demonstration.
const VISITOR: &str = "you";
/// The command line at this computer.
const TERMINAL: &str = "terminal";
/// The shortest password.
const SHORTEST: usize = 8;
/// The longest, bytes: hashing costs.
const LONGEST: usize = 256;

/// All who may, and how they are known.
pub(crate) struct People {
    accounts: Mutex<Accounts>,
    sessions: Mutex<Sessions>,
    guesses: Mutex<Guesses>,
    /// Passwords are looked at one after the other: each takes memory and time on purpose.
    hashing: Mutex<()>,
    /// So many wait for that.
    turns: AtomicUsize,
    /// What the terminal shows: it lets the first one in, or in a demonstration everybody.
    key: String,
    /// What programs of the same user at this computer have: the command line. It ends with the server.
    terminal: String,
    is_demo: bool,
}

/// So many passwords wait to be looked at; for one more there is no room.
const TURNS: usize = 8;

/// One that waits.
struct Turn<'a>(&'a AtomicUsize);

impl<'a> Turn<'a> {
    fn take(turns: &'a AtomicUsize) -> Result<Self, ApiError> {
        let turn = Self(turns);
        match turns.fetch_add(1, Ordering::SeqCst) < TURNS {
            true => Ok(turn),
            false => {
                let message = "too many log in at once: try again in a moment";
                Err(ApiError::too_many(message, Duration::from_secs(1)))
            }
        }
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// What the terminal's key opened.
pub(crate) enum Entered {
    /// A session, by its secret.
    Session(String),
    /// Somebody is to say who is the first user.
    Claim,
}

fn no_random(error: getrandom::Error) -> ApiError {
    ApiError::fault(format!("the system has no random numbers: {error}"))
}

fn wrong() -> ApiError {
    let message = "this name and password do not belong together";
    ApiError::new(StatusCode::UNAUTHORIZED, "not_known", message)
}

impl People {
    /// Those of that file; a demonstration has one user and keeps nothing.
    ///
    /// # Errors
    /// A sentence, where the file cannot be read.
    pub(crate) fn open(file: PathBuf, is_demo: bool) -> Result<Self, String> {
        let accounts = match is_demo {
            true => Accounts::default(),
            false => Accounts::read(file)?,
        };
        Ok(Self {
            accounts: Mutex::new(accounts),
            sessions: Mutex::default(),
            guesses: Mutex::default(),
            hashing: Mutex::default(),
            turns: AtomicUsize::new(0),
            key: secret().map_err(|e| e.to_string())?,
            terminal: secret().map_err(|e| e.to_string())?,
            is_demo,
        })
    }

    /// What the terminal shows, where it opens something.
    pub(crate) fn key(&self) -> Option<&str> {
        let opens = self.is_demo || lock(&self.accounts).users.is_empty();
        opens.then_some(&self.key)
    }

    /// What the command line at this computer has.
    pub(crate) fn terminal(&self) -> &str {
        &self.terminal
    }

    /// Whoever has the terminal's key.
    pub(crate) fn enter(&self, key: &str) -> Result<Entered, ApiError> {
        let stale = || {
            let message = "this link opens nothing any more: log in with name and password";
            ApiError::new(StatusCode::UNAUTHORIZED, "stale_link", message)
        };
        if checksum(key) != checksum(&self.key) || self.key().is_none() {
            return Err(stale());
        }
        match self.is_demo {
            true => Ok(Entered::Session(self.admit(VISITOR)?)),
            false => Ok(Entered::Claim),
        }
    }

    /// The first user, by the terminal's key.
    pub(crate) fn claim(&self, key: &str, name: &str, password: &str) -> Result<String, ApiError> {
        match self.enter(key)? {
            Entered::Session(session) => Ok(session),
            Entered::Claim => {
                self.add_user(name, password, Role::Admin)?;
                self.admit(name)
            }
        }
    }

    /// A session for whoever knows the password.
    pub(crate) fn log_in(
        &self,
        name: &str,
        password: &str,
        place: &str,
    ) -> Result<String, ApiError> {
        lock(&self.guesses).may(name, place, Instant::now())?;
        let _turn = Turn::take(&self.turns)?;
        let hash = lock(&self.accounts).user(name).map(|a| a.password.clone());
        let is_right = password.len() <= LONGEST && {
            let _one = lock(&self.hashing);
            // Also for a name that nobody has, so that time tells nothing.
            match hash {
                Some(hash) => is_password(password, &hash),
                None => hashed(password).is_err(),
            }
        };
        lock(&self.guesses).was(name, place, is_right, Instant::now());
        match is_right {
            true => self.admit(name),
            false => Err(wrong()),
        }
    }

    fn admit(&self, name: &str) -> Result<String, ApiError> {
        let session = secret().map_err(no_random)?;
        lock(&self.sessions).add(&checksum(&session), name, Instant::now());
        Ok(session)
    }

    /// Whether whoever came is somebody still: a session may have been ended, and a token or a user removed.
    pub(crate) fn knows(&self, caller: &Caller) -> bool {
        let is_session = lock(&self.sessions).user(&caller.key, Instant::now());
        is_session.is_some()
            || {
                let accounts = lock(&self.accounts);
                let mut tokens = accounts.tokens.iter();
                tokens.any(|t| t.checksum == caller.key)
            }
            || checksum(&self.terminal) == caller.key
    }

    /// Ends a session.
    pub(crate) fn log_out(&self, caller: &Caller) {
        lock(&self.sessions).remove(&caller.key);
    }

    /// Who has this session.
    pub(crate) fn of_session(&self, session: &str, here: bool) -> Option<Caller> {
        let key = checksum(session);
        let user = lock(&self.sessions).user(&key, Instant::now())?;
        let role = match self.is_demo {
            true => Role::Admin,
            false => lock(&self.accounts).user(&user)?.role,
        };
        Some(Caller {
            user,
            role,
            key,
            here,
            near: here,
        })
    }

    /// Which program has this token.
    pub(crate) fn of_token(&self, token: &str, here: bool) -> Option<Caller> {
        let key = checksum(token);
        if key == checksum(&self.terminal) {
            return Some(Caller {
                user: TERMINAL.into(),
                role: Role::Operator,
                key,
                here,
                near: here,
            });
        }
        let accounts = lock(&self.accounts);
        let found = accounts.tokens.iter().find(|t| t.checksum == key)?;
        // A token does no more than whoever made it may.
        let most = match self.is_demo {
            true => Role::Admin,
            false => accounts.user(&found.made_by)?.role,
        };
        Some(Caller {
            user: found.name.clone(),
            role: found.role.min(most),
            key,
            here,
            near: here,
        })
    }

    /// Names and roles of all users.
    pub(crate) fn users(&self) -> Vec<(String, Role)> {
        let accounts = lock(&self.accounts);
        let all = accounts.users.iter();
        all.map(|a| (a.name.clone(), a.role)).collect()
    }

    /// Another user.
    pub(crate) fn add_user(&self, name: &str, password: &str, role: Role) -> Result<(), ApiError> {
        self.keeps()?;
        check_name(name)?;
        if password.chars().count() < SHORTEST || password.len() > LONGEST {
            let message =
                format!("a password has {SHORTEST} letters or more, up to {LONGEST} bytes");
            return Err(ApiError::input(message));
        }
        let hash = {
            let _one = lock(&self.hashing);
            hashed(password).map_err(ApiError::fault)?
        };
        lock(&self.accounts).change(|accounts| {
            if accounts.user(name).is_some() {
                let message = format!("there is a user '{name}' already: take another name");
                return Err(ApiError::conflict("taken", message));
            }
            accounts.users.push(Account {
                name: name.into(),
                role,
                password: hash,
            });
            Ok(())
        })
    }

    /// Takes a user out, with sessions and tokens.
    pub(crate) fn remove_user(&self, name: &str) -> Result<(), ApiError> {
        self.keeps()?;
        lock(&self.accounts).change(|accounts| {
            let Some(at) = accounts.users.iter().position(|a| a.name == name) else {
                return Err(ApiError::missing(format!("there is no user '{name}'")));
            };
            let admins = accounts.users.iter().filter(|a| a.role == Role::Admin);
            if accounts.users[at].role == Role::Admin && admins.count() == 1 {
                let message = "the last admin stays: make another one first";
                return Err(ApiError::conflict("last_admin", message));
            }
            accounts.users.remove(at);
            accounts.tokens.retain(|t| t.made_by != name);
            Ok(())
        })?;
        lock(&self.sessions).remove_user(name);
        Ok(())
    }

    /// Names and roles of all tokens.
    pub(crate) fn tokens(&self) -> Vec<(String, Role)> {
        let accounts = lock(&self.accounts);
        let all = accounts.tokens.iter();
        all.map(|t| (t.name.clone(), t.role)).collect()
    }

    /// A token for a program. It is told once.
    pub(crate) fn add_token(&self, by: &str, name: &str, role: Role) -> Result<String, ApiError> {
        check_name(name)?;
        let token = secret().map_err(no_random)?;
        lock(&self.accounts).change(|accounts| {
            if accounts.tokens.iter().any(|t| t.name == name) {
                let message = format!("there is a token '{name}' already: take another name");
                return Err(ApiError::conflict("taken", message));
            }
            accounts.tokens.push(Token {
                name: name.into(),
                role,
                made_by: by.into(),
                checksum: checksum(&token),
            });
            Ok(())
        })?;
        Ok(token)
    }

    /// Ends a token.
    pub(crate) fn remove_token(&self, name: &str) -> Result<(), ApiError> {
        lock(&self.accounts).change(|accounts| {
            let before = accounts.tokens.len();
            accounts.tokens.retain(|t| t.name != name);
            match accounts.tokens.len() == before {
                true => Err(ApiError::missing(format!("there is no token '{name}'"))),
                false => Ok(()),
            }
        })
    }

    fn keeps(&self) -> Result<(), ApiError> {
        match self.is_demo {
            false => Ok(()),
            true => Err(ApiError::conflict(
                "demo",
                "the demonstration has one user: serve an instrument of your own for more",
            )),
        }
    }
}

fn check_name(name: &str) -> Result<(), ApiError> {
    let is_plain = |c: char| c.is_alphanumeric() || "-_. ".contains(c);
    let is_name = (1..=40).contains(&name.chars().count())
        && name.chars().all(is_plain)
        && name.trim() == name;
    match is_name {
        true => Ok(()),
        false => Err(ApiError::input(
            "a name has 1 to 40 letters, digits, blanks inside, '-', '_' and '.'",
        )),
    }
}

fn hashed(password: &str) -> Result<String, String> {
    let mut salt = [0u8; 16];
    getrandom::fill(&mut salt).map_err(|e| e.to_string())?;
    let hash = Argon2::default().hash_password_with_salt(password.as_bytes(), &salt);
    hash.map(|h| h.to_string()).map_err(|e| e.to_string())
}

fn is_password(password: &str, hash: &str) -> bool {
    let hash = PasswordHash::new(hash);
    hash.is_ok_and(|hash| {
        Argon2::default()
            .verify_password(password.as_bytes(), &hash)
            .is_ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn people() -> (tempfile::TempDir, People) {
        let dir = tempfile::tempdir().unwrap();
        let people = People::open(dir.path().join("people.json"), false).unwrap();
        (dir, people)
    }

    #[test]
    fn the_first_one_comes_by_the_terminals_link_and_nobody_after() {
        let (dir, people) = people();
        let key = people.key().unwrap().to_owned();
        assert!(people.claim("guess", "anna", "long enough").is_err());
        assert!(people.claim(&key, "anna", "short").is_err());
        let session = people.claim(&key, "anna", "long enough").unwrap();
        let anna = people.of_session(&session, true).unwrap();
        assert_eq!((anna.user.as_str(), anna.role), ("anna", Role::Admin));
        assert_eq!(people.key(), None);
        assert!(people.claim(&key, "eve", "long enough").is_err());
        // Another start knows her; what is kept is no password.
        let file = dir.path().join("people.json");
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains("$argon2id$") && !text.contains("long enough"));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(&file).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        let again = People::open(file, false).unwrap();
        assert!(again.of_session(&session, true).is_none());
        assert!(again.log_in("anna", "long enougH", "here").is_err());
        let session = again.log_in("anna", "long enough", "here").unwrap();
        let anna = again.of_session(&session, true).unwrap();
        again.log_out(&anna);
        assert!(again.of_session(&session, true).is_none());
    }

    #[test]
    fn who_goes_takes_sessions_and_tokens_along_and_one_admin_stays() {
        let (_dir, people) = people();
        people.add_user("anna", "long enough", Role::Admin).unwrap();
        people
            .add_user("bob", "long enough", Role::Operator)
            .unwrap();
        assert!(people.add_user("bob", "long enough", Role::Viewer).is_err());
        assert!(people.remove_user("anna").is_err());
        let bob = people.log_in("bob", "long enough", "here").unwrap();
        // No token does more than its maker may.
        let token = people.add_token("bob", "script", Role::Admin).unwrap();
        assert_eq!(people.of_token(&token, true).unwrap().role, Role::Operator);
        people.remove_user("bob").unwrap();
        assert!(people.of_session(&bob, true).is_none());
        assert!(people.of_token(&token, true).is_none());
        assert!(people.tokens().is_empty());
    }

    #[test]
    fn who_guesses_has_to_wait_and_nobody_else_has() {
        let (_dir, people) = people();
        people.add_user("anna", "long enough", Role::Admin).unwrap();
        people.add_user("bob", "long enough", Role::Viewer).unwrap();
        let wrong = |n: usize| {
            let guess = format!("guess {n}");
            people.log_in("anna", &guess, "there").unwrap_err()
        };
        let codes: Vec<String> = (0..8).map(|n| wrong(n).code).collect();
        assert_eq!(codes[..5], ["not_known"; 5]);
        assert_eq!(codes[5..], ["too_many"; 3]);
        assert!(people.log_in("anna", "long enough", "there").is_err());
        people.log_in("bob", "long enough", "there").unwrap();
        people.log_in("anna", "long enough", "here").unwrap();
    }

    #[test]
    fn who_waits_for_a_password_to_be_looked_at_has_a_turn() {
        let turns = AtomicUsize::new(0);
        let all: Vec<_> = (0..TURNS).map(|_| Turn::take(&turns).unwrap()).collect();
        let one_more = Turn::take(&turns).err().unwrap();
        assert_eq!(one_more.retry_after, Some(Duration::from_secs(1)));
        drop(all);
        assert!(Turn::take(&turns).is_ok());
        assert_eq!(turns.load(Ordering::SeqCst), 0);
    }
}
