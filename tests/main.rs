

mod captures;
