// Elements of SVG.

const SVG = "http://www.w3.org/2000/svg";

// A new one with its attributes, below a parent if there is one.
function svg(name, attributes = {}, parent = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}
