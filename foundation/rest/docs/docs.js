// Shows the API's own schema. No validator elsewhere is asked.
SwaggerUIBundle({
  url: '/openapi.json',
  dom_id: '#page',
  deepLinking: true,
  displayOperationId: false,
  validatorUrl: null,
  presets: [SwaggerUIBundle.presets.apis],
  onComplete: () => { document.title = document.querySelector('.info .title')?.firstChild?.textContent ?? document.title; },
});
