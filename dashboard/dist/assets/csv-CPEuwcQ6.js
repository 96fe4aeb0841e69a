function i(t){const e=[[]];let n="",r=!1;for(let l=0;l<t.length;l++){const s=t[l];r?s!=='"'?n+=s:t[l+1]==='"'?(n+='"',l++):r=!1:s==='"'?r=!0:s===","||s===`
`?(e[e.length-1].push(n.replace(/\r$/,"")),n="",s===`
`&&e.push([])):n+=s}return(n||e[e.length-1].length)&&e[e.length-1].push(n),e.filter(l=>l.length>0)}const o=/^-?\d*\.?\d+(e[+-]?\d+)?$/i,f=t=>{const e=o.test(t)?t.replace(".",","):t;return/[";\n\r]/.test(e)?`"${e.replaceAll('"','""')}"`:e},c=t=>`\uFEFF${i(t).map(e=>e.map(f).join(";")).join(`\r
`)}\r
`;export{i as fieldsOf,c as withCommas};
