"""A script for the live page that holds its pictures back."""

CATCH = """
const Own = window.EventSource;
window.EventSource = class extends Own {
  set onmessage(f) {
    super.onmessage = e => {
      if (!this.url.includes('/api/watch')) { f(e); return; }
      window.last ??= JSON.parse(e.data);
      if (!window.held) { window.last = JSON.parse(e.data); f(e); }
    };
    if (this.url.includes('/api/watch')) window.show = p => f({data: JSON.stringify(p)});
  }
};
"""
"""Holds the pictures of the page back, so that a test can show one that it has changed."""
