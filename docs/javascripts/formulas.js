// Typesets what mkdocs has marked as a formula: \(..\) in a line, \[..\] by itself.
document$.subscribe(() => {
  for (const element of document.querySelectorAll(".arithmatex")) {
    const tex = element.textContent.trim().slice(2, -2);
    katex.render(tex, element, {displayMode: element.tagName === "DIV", throwOnError: false});
  }
});
