mod captures;
mod reference;
