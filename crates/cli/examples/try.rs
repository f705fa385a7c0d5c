use scopeservo_registration::*;
use scopeservo_sift::*;
fn main() {
    let mut a = std::env::args().skip(1);
    let load = |p: String| { let i = image::open(p).unwrap().to_luma8(); GrayImage::from_fn(i.width() as usize, i.height() as usize, |x,y| f32::from(i.get_pixel(x as u32,y as u32)[0])/255.0).unwrap() };
    let (v,t)=(load(a.next().unwrap()),load(a.next().unwrap()));
    let mut s=Sift::new(scopeservo_sift::Options{max_features:2000,..Default::default()}).unwrap();
    let (fv,ft)=(s.detect_and_describe(&v),s.detect_and_describe(&t));
    let t0=std::time::Instant::now();
    let (r,verdict)=register_pictures(&mut s,(&v,&fv),(&t,&ft),&Prior::default(),&scopeservo_registration::Options::default(),Allow::default()).unwrap();
    println!("{:?} inliers {} of {} \n{verdict:?}", t0.elapsed(), r.inliers, r.matches);
    if let Ok(e)=&r.outcome { 
      let pair=likeness::Pair::new(&v,&t,1.0); println!("share alike {}", pair.share_alike(&e.target_from_view));
      if let Some(rv)=find_rival(&fv,&ft,&r,&Prior::default(),&scopeservo_registration::Options::default(),false){ println!("{rv:?}\n{:?} -> {:?}", pair.compare(&e.target_from_view,&pair.refined(&rv.target_from_view),|_|true), contest(&pair,&e.target_from_view,&rv,|_|true)); } else {println!("no rival")} }
}
